"""Monte Carlo sensitivity analysis, section 3.4 of the paper."""

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from .._arguments import whole_number
from .._errors import SimulationError
from .._executor import Executor
from .._waiting import counting
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..simulation import reduce_batch
from ._central_values import central_values, rescaled_draws
from ._correlation_coefficients import pearson, spearman
from ._correlation_intervals import pearson_interval, spearman_interval
from ._paired_twins import distinct_names, paired_twins
from ._sampling import normal_draws
from ._sensitivity import MEAN, Sensitivity


def correlate_costs(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
    *,
    draws: int,
    spread: float,
    seed: int,
    names: Iterable[str] | None,
    executor: Executor | None,
    on_progress: Callable[[int], None] | None,
) -> Sensitivity:
    """Computes the correlations of costs with parameters. The arguments are those of `sensitivity`,
    checked."""
    began = time.perf_counter()
    twins, recordings = paired_twins("sensitivity", twin, experiments)
    draws = whole_number("sensitivity: draws", draws, 3, SimulationError)
    first = twins[0]
    values = central_values(first, names)
    samples = normal_draws(values, spread, seed, draws)
    columns: list[tuple[str, np.ndarray]] = []
    failed = np.zeros(draws, dtype=bool)
    report = counting(draws * len(recordings), on_progress)
    for twin_of_experiment, experiment in zip(twins, recordings, strict=True):
        result = reduce_batch(
            twin_of_experiment,
            experiment,
            rescaled_draws(twin_of_experiment, values, samples),
            ["cost"],
            executor=executor,
            on_progress=report,
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
