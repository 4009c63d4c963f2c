"""Monte Carlo sensitivity analysis, section 3.4 of the paper."""

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from .._errors import ParameterError, SimulationError
from ..io import Experiment
from ..physics import Twin
from ..simulation import simulate_batch
from ._indices import pearson, pearson_interval
from ._sampling import normal_draws
from ._sensitivity import MEAN, Sensitivity


def sensitivity(
    twin: Twin | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment],
    *,
    draws: int = 50,
    spread: float | int = 0.25,
    seed: int = 0,
    parameters: Iterable[str] | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Sensitivity:
    """Which parameters the cost depends on, by random draws around the matched values.

    Every parameter is drawn from a normal distribution around its value, independently of the
    others and kept positive; for each draw the mean squared error of every channel against its
    recording is computed. The index is the Pearson correlation between the two, as in the paper,
    with its 95 % interval: fifty draws leave it uncertain by +-0.28.

    **Arguments:**

    - `twin`: the matched twin, or one for each experiment (`fit.twins.values()`) where recordings
      have values of their own.
    - `experiments`: recordings.
    - `draws`: 50 in the paper.
    - `spread`: standard deviation as a part of the value, 0.25 in the paper.
    - `seed`: the same seed gives the same draws.
    - `parameters`: names; by default those that the rig calls free and all recordings share.
    - `on_progress`: called with the number of newly finished simulations.

    **Returns:** a `Sensitivity`.

    **Raises:** `ParameterError` for unknown names or a value of zero, `SimulationError` where an
    experiment has no recorded temperatures or a number is out of range.
    """
    began = time.perf_counter()
    recordings = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    twins = [twin] * len(recordings) if isinstance(twin, Twin) else list(twin)
    if not recordings or len(twins) != len(recordings):
        raise SimulationError(
            f"sensitivity: found {len(twins)} twins for {len(recordings)} experiments, allowed is "
            "one for all or one each"
        )
    if draws < 3 or not 0 < spread < 1:
        raise SimulationError(
            f"sensitivity: found draws = {draws}, spread = {spread}, allowed are at least 3 draws "
            "and a spread between 0 and 1"
        )
    first = twins[0]
    values = _values(first, parameters)
    samples = normal_draws(values, float(spread), seed, draws)
    columns: list[tuple[str, np.ndarray]] = []
    failed = np.zeros(draws, dtype=bool)
    for one, experiment in zip(twins, recordings, strict=True):
        # Draws are relative, so that twins with values of their own get the same ones.
        own = {
            name: float(one.parameters[name]) / values[name] * sample
            for name, sample in samples.items()
        }
        result = simulate_batch(one, experiment, own, reductions=["cost"], on_progress=on_progress)
        assert result.cost is not None
        failed |= result.failed
        columns += zip(result.channels, result.cost.T, strict=True)
    cost = np.column_stack([column for _, column in columns])
    cost = np.column_stack([cost, cost.mean(axis=1)])
    table = np.column_stack(list(samples.values()))
    correlation = pearson(cost[~failed], table[~failed])
    return Sensitivity(
        rig=first.rig.name,
        names=tuple(values),
        values=np.array(list(values.values())),
        channels=(*_distinct([name for name, _ in columns]), MEAN),
        correlation=correlation,
        interval=pearson_interval(correlation, int((~failed).sum())),
        samples=table,
        cost=cost,
        failed=failed,
        spread=float(spread),
        seed=seed,
        wall_time=time.perf_counter() - began,
    )


def _values(twin: Twin, parameters: Iterable[str] | None) -> dict[str, float]:
    table = twin.rig.parameters
    if parameters is None:
        names = [name for name, row in table.items() if row.free and row.scope == "shared"]
    else:
        names = list(dict.fromkeys(parameters))
    unknown = [name for name in names if name not in table]
    if unknown or not names:
        raise ParameterError(
            f"{twin.rig.name}: parameters: found {', '.join(unknown) or 'none'}, allowed are "
            f"{', '.join(table)}"
        )
    values = {name: float(twin.parameters[name]) for name in names}
    for name, value in values.items():
        if value == 0:
            raise ParameterError(
                f"{twin.rig.name}: parameter {name}: found 0, allowed is a value to spread around"
            )
    return values


def _distinct(names: list[str]) -> list[str]:
    """Channel names; where two recordings share one, the later ones carry a number."""
    seen: dict[str, int] = {}
    labels = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        labels.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return labels
