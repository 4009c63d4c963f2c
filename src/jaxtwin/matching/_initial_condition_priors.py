"""Priors of the states in which a recording begins.

Room, plate and sinks are different states with different priors:

- The *room* has the mean of the fit's recordings and their standard deviation; without a fit, the
  twin's value and the prior of the rig file.
- The *plate* begins at the first readings of its channels.
- The *sinks* begin near the room, with an uncertainty that grows with the plate's distance from it.
- A rig *at rest* has equal plate and room temperatures. The difference between the two has a Cauchy
  prior, which pulls them together unless the readings contradict. It enters the least squares
  problem by reweighting (Holland and Welsch 1977).
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
"""Prior standard deviation of the room temperature between recordings, K. It counts as much as
`ROOM_WEIGHT` recordings."""

ROOM_WEIGHT = 1.0

SINK_SHARE = 0.2
"""Standard deviation of a sink's distance from the room, as a part of the plate's distance from it.
"""


def with_prior(
    row: Parameter, rig: Rig, first: float, earlier: Mapping[str, Mapping[str, float]]
) -> Parameter:
    """A parameter of a recording with its prior."""
    if row.name in _plate(rig) | _sinks(rig):
        # The first readings and the prior of differences determine the other values.
        standard_deviation = 10.0 + 0.5 * abs(first - row.value)
        return _around(replace(row, value=first), first, standard_deviation)
    known = np.array([values[row.name] for values in earlier.values() if row.name in values])
    if row.is_logarithmic:
        known = np.log(known)
    usual = ROOM_DEVIATION if row.name in room_parameters(rig) else row.prior_spread
    if not len(known) or usual is None:
        return row if row.prior_value is None else replace(row, prior_value=row.value)
    squares = ROOM_WEIGHT * usual**2 + float(np.sum((known - known.mean()) ** 2))
    variance = squares / (ROOM_WEIGHT + len(known) - 1) * (1 + 1 / len(known))
    centre = float(np.exp(known.mean()) if row.is_logarithmic else known.mean())
    return _around(row, centre, math.sqrt(variance))


def _around(row: Parameter, centre: float, standard_deviation: float) -> Parameter:
    """The parameter with a prior, and with bounds that do not cut the prior off."""
    if row.is_logarithmic:
        return replace(row, prior_value=centre, prior_spread=standard_deviation)
    lower, upper = (
        min(row.lower, centre - 5 * standard_deviation),
        max(row.upper, centre + 5 * standard_deviation),
    )
    return replace(
        row, prior_value=centre, prior_spread=standard_deviation, lower=lower, upper=upper
    )


def prior_of_differences(
    rig: Rig, unknowns: Unknowns, room: float | None, first: float
) -> LinearPrior:
    """The prior of the differences of plate and sinks from the room.

    **Arguments:**

    - `room`: the room temperature of the last round, degC; None for a rig at rest.
    - `first`: the first reading, degC.
    """
    names = [row.name for row in unknowns.per_recording]
    rooms = [names.index(name) for name in room_parameters(rig) if name in names]
    if not rooms:
        return LinearPrior.none(len(names))
    away = 0.0 if room is None else first - room
    standard_deviations = dict.fromkeys(_plate(rig), math.hypot(REST_SCALE, away))
    standard_deviations |= dict.fromkeys(_sinks(rig), math.hypot(REST_SCALE, SINK_SHARE * away))
    rows = []
    for name, standard_deviation in standard_deviations.items():
        if name in names:
            row = np.zeros(len(names))
            row[names.index(name)], row[rooms[0]] = 1 / standard_deviation, -1 / standard_deviation
            rows.append(row)
    return LinearPrior(np.array(rows).reshape(-1, len(names)), np.zeros(len(rows)))


def names_in(*values: Value | None) -> frozenset[str]:
    """Names of the parameters on which some values depend."""
    return frozenset(name for value in values if value is not None for name, _ in value.powers)


def room_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the room temperature at the start."""
    return names_in(rig.ambient_temperature)


def _plate(rig: Rig) -> frozenset[str]:
    return names_in(rig.initial_temperature) - room_parameters(rig)


def _sinks(rig: Rig) -> frozenset[str]:
    starts = [
        value for c in rig.cells for value in (c.initial_temperature, c.sink_initial_temperature)
    ]
    starts += [body.initial_temperature for body in rig.bodies]
    return names_in(*starts) - room_parameters(rig) - _plate(rig)
