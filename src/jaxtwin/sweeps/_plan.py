"""The plan of a sweep: its draws, its chunks, and the results that are kept."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from jaxtyping import Float, Shaped

from .. import __version__
from .._arguments import whole_number
from ..errors import SimulationError
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..sensitivity_analysis._inputs import central_values, rescaled_draws
from ..sensitivity_analysis._outputs import distinct_names, paired_twins
from ..sensitivity_analysis._sampling import checked_seed, checked_spread, normal_draws
from ..simulation import (
    REDUCTIONS,
    Precision,
    ReductionName,
    checked_channels,
    checked_precision,
    checked_reductions,
    reduce_batch,
)

# The format of the store. It changes with the arrays and with the order of draws.
FORMAT = 2

# Name of an array -> its second dimension and its unit.
ROLES = {"failed": ("", "")} | {
    name: (reduction.dimension, reduction.unit) for name, reduction in REDUCTIONS.items()
}


@final
@dataclass(frozen=True, eq=False)
class Plan:
    """The checked arguments of a sweep.

    **Arguments:**

    - `twins`, `experiments`: the experiments, and a twin for each.
    - `values`: name -> value around which the parameter is drawn, in the rig's unit. They have the
      order of the rig's parameters, which is that of the random numbers.
    - `draws`, `spread`, `seed`: as in `normal_draws`.
    - `reductions`, `precision`: as in `reduce_batch`.
    - `chunk_size`: the number of draws that are written at a time.
    """

    twins: tuple[Twin, ...]
    experiments: tuple[Experiment, ...]
    values: dict[str, float]
    draws: int
    spread: float
    seed: int
    reductions: tuple[ReductionName, ...]
    precision: Precision
    chunk_size: int

    @property
    def chunks(self) -> int:
        """The number of chunks. The last may be shorter than the others."""
        return -(-self.draws // self.chunk_size)

    def span(self, chunk: int) -> tuple[int, int]:
        """The first draw of a chunk, and the first draw after it."""
        return chunk * self.chunk_size, min((chunk + 1) * self.chunk_size, self.draws)

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the channels of all experiments. Repeated names are numbered."""
        names = map(checked_channels, self.twins, self.experiments)
        return tuple(distinct_names(name for channels in names for name in channels))

    @property
    def recordings(self) -> tuple[str, ...]:
        """The names of the experiments. Repeated names are numbered."""
        names = [experiment.name or "experiment" for experiment in self.experiments]
        return tuple(distinct_names(names))

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Everything that the results depend on, in plain types for JSON."""
        return {
            "format": FORMAT,
            "program": f"jaxtwin {__version__}",
            "rig": self.twins[0].rig.name,
            "rig_content": self.twins[0].rig.fingerprint,
            "recordings": list(self.recordings),
            "experiments": [experiment.fingerprint for experiment in self.experiments],
            "values": [
                {name: float(value) for name, value in twin.values.items()} for twin in self.twins
            ],
            "drawn": self.values,
            "spread": self.spread,
            "seed": self.seed,
            "draws": self.draws,
            "reductions": list(self.reductions),
            "precision": self.precision,
            "chunk_size": self.chunk_size,
            "channels": list(self.channels),
        }

    def samples(self, start: int, stop: int) -> dict[str, Float[np.ndarray, " draws"]]:
        """The draws from `start` to `stop`: parameter -> value in each draw."""
        return normal_draws(self.values, self.spread, self.seed, stop, start)

    def solve(
        self, chunk: int, on_progress: Callable[[int], None] | None, workers: int | None = None
    ) -> dict[str, Shaped[np.ndarray, "draws *columns"]]:
        """Simulates the draws of a chunk.

        **Arguments:**

        - `on_progress`, `workers`: as in `reduce_batch`.

        **Returns:** name of the array -> results of the draws.
        """
        samples = self.samples(*self.span(chunk))
        kept: dict[str, list[np.ndarray]] = {name: [] for name in self.reductions}
        failed = np.zeros(len(next(iter(samples.values()))), dtype=bool)
        for twin, experiment in zip(self.twins, self.experiments, strict=True):
            result = reduce_batch(
                twin,
                experiment,
                rescaled_draws(twin, self.values, samples),
                self.reductions,
                precision=self.precision,
                workers=workers,
                on_progress=on_progress,
            )
            failed |= result.failed
            for name in self.reductions:
                kept[name].append(getattr(result, name))
        arrays = {name: np.column_stack(parts) for name, parts in kept.items()}
        return {"failed": failed, **arrays}


def plan_sweep(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
    *,
    draws: int,
    spread: float | int,
    seed: int,
    names: Iterable[str] | None,
    reductions: Iterable[str] | None,
    precision: Precision,
    chunk_size: int,
) -> Plan:
    """Checks the arguments of `sweep` and makes its plan.

    **Raises:** as `sweep`.
    """
    twins, recordings = paired_twins("sweep", twin, experiments)
    for name, number in (("draws", draws), ("chunk_size", chunk_size)):
        whole_number(f"sweep: {name}", number, 1, SimulationError)
    if reductions is None:
        recorded = all(recording.temperatures is not None for recording in recordings)
        reductions = ("cost", "final") if recorded else ("final",)
    asked = checked_reductions(reductions, recordings, twins[0].rig)
    central = central_values(twins[0], names)
    plan = Plan(
        twins=tuple(twins),
        experiments=tuple(recordings),
        values={name: central[name] for name in twins[0].rig.parameters if name in central},
        draws=int(draws),
        spread=checked_spread("sweep: spread", spread),
        seed=checked_seed("sweep: seed", seed),
        # Sorted like the names, so that the order in which they were given changes nothing.
        reductions=tuple(name for name in REDUCTIONS if name in asked),
        precision=checked_precision(precision),
        chunk_size=int(chunk_size),
    )
    plan.identity  # noqa: B018 - asks for channels, and so finds experiments of another rig
    return plan
