"""The paper's sensitivity analysis, section 3.4: the correlations of costs with parameters over
random draws."""

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from .._arguments import whole_number
from .._executor import Executor
from .._waiting import announced
from ..errors import SimulationError
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ._correlation_coefficients import pearson, spearman
from ._correlation_intervals import pearson_interval, spearman_interval
from ._correlations import Pearson
from ._global_analysis import WHERE, check_options, run_experiments
from ._input_choices import resolve_inputs
from ._outputs import failed_runs
from ._paired_twins import distinct_names, paired_twins
from ._sampling import checked_seed, checked_spread
from ._sensitivity import MEAN, Sensitivity

# Its draws are those of the paper: independent and random, each a run.
METHOD = Pearson()


@announced("sensitivity analysis")
def sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    draws: int = 50,
    spread: float | int = 0.25,
    seed: int = 0,
    names: Iterable[str] | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Sensitivity:
    """Finds the parameters that matter for the error of a twin, by runs with other values of them.
    This is the analysis of the paper.

    Every parameter is drawn from a normal distribution around its value, independently of the
    others and truncated to positive values. For each draw the mean squared error of every channel
    against its recording is computed. The index is the Pearson correlation between the two. The
    result also has Spearman's correlation, which is that of their ranks. Both have 95 % confidence
    intervals: with fifty draws they are uncertain by about 0.3. A cost has heavy tails, so that
    Pearson's correlation depends on a few extreme draws; the ranks show the relation that holds for
    most draws. Near an optimum the cost is quadratic, which no correlation can show.
    `global_sensitivity` has other methods, for any outputs and inputs.

    **Arguments:**

    - `twin`: a fit, in which each recording has its own values (those of a recording that was not
      matched are estimated from its first minute, see `Fit.twin_for`); or a single twin for all
      experiments, or a twin for each.
    - `experiments`: one or several experiments with recorded temperatures; None for those of the
      fit.
    - `draws`: the number of draws, at least 3; 50 in the paper.
    - `spread`: the standard deviation relative to each value, 0.25 in the paper.
    - `seed`: the same seed gives the same numbers.
    - `names`: the names of the parameters to draw; None for the free parameters that all recordings
      share.
    - `executor`: an executor whose workers run the draws instead of this process, see
      `simulate_batch`.
    - `on_progress`: called with the number of newly finished simulations.

    **Raises:** `ParameterError` for unknown names or a value of zero; `SimulationError` if an
    experiment has no recorded temperatures, an argument is out of range, or an executor fails;
    `MatchError` if a recording that was not matched is too short to estimate its values.
    """
    began = time.perf_counter()
    check_options(executor, on_progress)
    twins, recordings = paired_twins(WHERE, twin, experiments)
    draws = whole_number(f"{WHERE}: draws", draws, METHOD.min_draws, SimulationError)
    spread, seed = checked_spread(f"{WHERE}: spread", spread), checked_seed(f"{WHERE}: seed", seed)
    inputs = resolve_inputs("normal", twin, twins[0], names, spread)
    samples = METHOD.design(inputs, draws, seed, METHOD.default_samples).samples
    columns, _ = run_experiments(
        twins, recordings, inputs, samples, METHOD, {"cost": "cost"}, None, executor, on_progress
    )
    cost, failed = np.column_stack([column for _, column in columns]), failed_runs(columns)
    counted = cost[~failed], samples[~failed]
    return Sensitivity(
        rig=twins[0].rig.name,
        names=inputs.names,
        values=np.array([float(twins[0].values[name]) for name in inputs.names]),
        channels=(*distinct_names(output.channel for output, _ in columns[:-1]), MEAN),
        correlation=pearson(*counted),
        interval=pearson_interval(*counted),
        rank_correlation=spearman(*counted),
        rank_interval=spearman_interval(*counted),
        samples=samples,
        cost=cost,
        failed=failed,
        spread=spread,
        seed=seed,
        wall_time=time.perf_counter() - began,
    )
