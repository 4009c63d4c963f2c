r"""What is known of the states that a recording begins with, before it is looked at.

They are different states, and each has its own prior:

- the *room* is expected where the fit's recordings had it, give or take their differences;
  without a fit, where the twin has it, with the spread of the rig file's prior;
- the *plate* begins where its channels read first;
- the *sinks* begin near the room, the less so the farther the plate is from it;
- a rig that stood still before is *at rest*: plate and room are then equal. The difference between
  the two has a Cauchy prior, which draws them together where nothing speaks against it and lets
  them go where the readings do. It is put into least squares by reweighting (Holland and Welsch
  1977).
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..rig import Parameter, Rig, Value
from ._linear_prior import LinearPrior
from ._unknowns import Unknowns

REST_SCALE = 1.0
"""Scale of the Cauchy prior of the difference between plate and room, K."""

ROOM_DEVIATION = 2.0
"""Standard deviation of the room between recordings before any has been seen, K. It counts as much
as so many recordings as `ROOM_WEIGHT` says."""

ROOM_WEIGHT = 1.0

SINK_SHARE = 0.2
"""How far a sink may be from the room, as a part of the plate's distance from it."""


def with_prior(
    row: Parameter, rig: Rig, first: float, earlier: Mapping[str, Mapping[str, float]]
) -> Parameter:
    """A value of a recording with its prior."""
    if row.name in _plate(rig) | _sinks(rig):
        # The first readings and the differences from the room say the rest.
        spread = 10.0 + 0.5 * abs(first - row.value)
        return _around(replace(row, value=first), first, spread)
    seen = np.array([values[row.name] for values in earlier.values() if row.name in values])
    if row.is_logarithmic:
        seen = np.log(seen)
    usual = ROOM_DEVIATION if row.name in room_parameters(rig) else row.prior_spread
    if not len(seen) or usual is None:
        return row if row.prior_value is None else replace(row, prior_value=row.value)
    squares = ROOM_WEIGHT * usual**2 + float(np.sum((seen - seen.mean()) ** 2))
    variance = squares / (ROOM_WEIGHT + len(seen) - 1) * (1 + 1 / len(seen))
    centre = float(np.exp(seen.mean()) if row.is_logarithmic else seen.mean())
    return _around(row, centre, math.sqrt(variance))


def _around(row: Parameter, centre: float, spread: float) -> Parameter:
    """With a prior, and bounds that do not cut it off."""
    if row.is_logarithmic:
        return replace(row, prior_value=centre, prior_spread=spread)
    lower, upper = min(row.lower, centre - 5 * spread), max(row.upper, centre + 5 * spread)
    return replace(row, prior_value=centre, prior_spread=spread, lower=lower, upper=upper)


def prior_of_differences(
    rig: Rig, unknowns: Unknowns, room: float | None, first: float
) -> LinearPrior:
    """The prior of how far plate and sinks are from the room.

    **Arguments:**

    - `room`: as the last round has it, degC; None for a rig at rest.
    - `first`: what was read first, degC.
    """
    names = [row.name for row in unknowns.per_recording]
    rooms = [names.index(name) for name in room_parameters(rig) if name in names]
    if not rooms:
        return LinearPrior.none(len(names))
    away = 0.0 if room is None else first - room
    deviations = dict.fromkeys(_plate(rig), math.hypot(REST_SCALE, away))
    deviations |= dict.fromkeys(_sinks(rig), math.hypot(REST_SCALE, SINK_SHARE * away))
    rows = []
    for name, deviation in deviations.items():
        if name in names:
            row = np.zeros(len(names))
            row[names.index(name)], row[rooms[0]] = 1 / deviation, -1 / deviation
            rows.append(row)
    return LinearPrior(np.array(rows).reshape(-1, len(names)), np.zeros(len(rows)))


def names_in(*values: Value | None) -> frozenset[str]:
    """The parameters that take part in some values."""
    return frozenset(name for value in values if value is not None for name, _ in value.powers)


def room_parameters(rig: Rig) -> frozenset[str]:
    """Those that say how warm the room is at the start."""
    return names_in(rig.ambient_temperature)


def _plate(rig: Rig) -> frozenset[str]:
    return names_in(rig.initial_temperature) - room_parameters(rig)


def _sinks(rig: Rig) -> frozenset[str]:
    starts = [
        value for c in rig.cells for value in (c.initial_temperature, c.sink_initial_temperature)
    ]
    return names_in(*starts) - room_parameters(rig) - _plate(rig)
