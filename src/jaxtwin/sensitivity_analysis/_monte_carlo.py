"""Monte Carlo sensitivity analysis, section 3.4 of the paper."""

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from .._arguments import check_callable, whole_number
from .._errors import SimulationError
from .._waiting import announced
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..simulation import simulate_batch
from ._draws import central_values, distinct_names, paired_twins, rescaled_draws
from ._indices import pearson, spearman
from ._intervals import pearson_interval, spearman_interval
from ._sampling import checked_seed, checked_spread, normal_draws
from ._sensitivity import MEAN, Sensitivity


@announced("sensitivity analysis")
def sensitivity(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None = None,
    *,
    draws: int = 50,
    spread: float | int = 0.25,
    seed: int = 0,
    parameters: Iterable[str] | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Sensitivity:
    """Finds the parameters on which the cost depends, by random draws around the matched values.

    Every parameter is drawn from a normal distribution around its value, independently of the
    others and kept positive; for each draw the mean squared error of every channel against its
    recording is computed. The index is the Pearson correlation between the two, as in the paper;
    beside it stands Spearman's, that of their ranks. Both have 95 % confidence intervals: fifty
    draws leave them uncertain by about +-0.3. A cost has heavy tails, and Pearson's correlation
    rests on the few draws furthest out: look at the ranks for what holds for most draws.

    **Arguments:**

    - `twin`: a fit, of which each recording uses its own values (those of a recording that was
      not matched are estimated from its first minute, see `Fit.twin_for`); or one
      twin for all experiments, or one for each.
    - `experiments`: one or several, with recorded temperatures; None for those of the fit.
    - `draws`: how many, at least 3; 50 in the paper.
    - `spread`: standard deviation of the draws relative to the value, 0.25 in the paper.
    - `seed`: the same seed gives the same draws.
    - `parameters`: names of those to draw; None for the free ones that all recordings share.
    - `on_progress`: called with the number of newly finished simulations.

    **Returns:** a `Sensitivity`.

    **Raises:** `ParameterError` for unknown names or a value of zero, `SimulationError` where an
    experiment has no recorded temperatures or a number is out of range, `MatchError` where a
    recording that a fit has not seen is too short to take its own values from.
    """
    began = time.perf_counter()
    twins, recordings = paired_twins("sensitivity", twin, experiments)
    draws = whole_number("sensitivity: draws", draws, 3, SimulationError)
    seed = checked_seed("sensitivity: seed", seed)
    spread = checked_spread("sensitivity: spread", spread)
    check_callable("sensitivity: on_progress", on_progress, SimulationError)
    first = twins[0]
    values = central_values(first, parameters)
    samples = normal_draws(values, spread, seed, draws)
    columns: list[tuple[str, np.ndarray]] = []
    failed = np.zeros(draws, dtype=bool)
    for twin_of_experiment, experiment in zip(twins, recordings, strict=True):
        result = simulate_batch(
            twin_of_experiment,
            experiment,
            rescaled_draws(twin_of_experiment, values, samples),
            reductions=["cost"],
            on_progress=on_progress,
        )
        assert result.cost is not None
        failed |= result.failed
        columns += zip(result.channels, result.cost.T, strict=True)
    cost = np.column_stack([column for _, column in columns])
    cost = np.column_stack([cost, cost.mean(axis=1)])
    table = np.column_stack(list(samples.values()))
    counted = cost[~failed], table[~failed]
    return Sensitivity(
        rig=first.rig.name,
        names=tuple(values),
        values=np.array(list(values.values())),
        channels=(*distinct_names(name for name, _ in columns), MEAN),
        correlation=pearson(*counted),
        interval=pearson_interval(*counted),
        rank_correlation=spearman(*counted),
        rank_interval=spearman_interval(*counted),
        samples=table,
        cost=cost,
        failed=failed,
        spread=spread,
        seed=seed,
        wall_time=time.perf_counter() - began,
    )
