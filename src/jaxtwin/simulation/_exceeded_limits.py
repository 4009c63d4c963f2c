"""The limits of a rig that a run exceeds."""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from ..rig import Rig

if TYPE_CHECKING:
    from ._run import Run


def exceeded_limits(run: "Run", rig: Rig, recorded: float = -math.inf) -> tuple[str, ...]:
    """A sentence for each kind of limit that is exceeded, about the hottest channel or cell.

    **Arguments:**

    - `recorded`: the hottest reading of the rig itself, degC. Limits below it are left out.
    """
    result = []
    if rig.limits is not None:
        limit = rig.limits.temperature - ZERO_CELSIUS
        if limit >= recorded:
            result += _beyond(run, run.channels, run.temperatures, limit, "the limit of channels")
    given = None if rig.limits is None else rig.limits.cell_temperature
    limit = min(rig.maximum_side_temperatures, default=math.inf) - ZERO_CELSIUS
    if limit < recorded:
        return tuple(result)
    sides = [f"{cell.name}.{side}" for cell in rig.cells for side in ("TC", "TH")]
    if given is not None:  # a heater has no solder between two plates
        sides += [heater.node for heater in rig.heaters]
    states = run.states[:, [run.nodes.index(node) for node in sides]]
    what = "at which solder melts" if given is None else "the limit of cells"
    return (*result, *_beyond(run, tuple(sides), states, limit, what))


def _beyond(
    run: "Run",
    names: tuple[str, ...],
    temperatures: Float[np.ndarray, "times places"],
    limit: float,
    what: str,
) -> list[str]:
    if not names or not temperatures.max() > limit:
        return []
    time, place = np.unravel_index(np.argmax(temperatures), temperatures.shape)
    first = run.time[np.argmax((temperatures > limit).any(axis=1))]
    reached = f"{names[place]} reaches {temperatures[time, place]:.1f} degC"
    return [f"{reached}, above {limit:g} degC, {what}, from {first:g} s on"]
