"""Priors of the states in which a recording begins.

Room, plate and hidden states (sinks, bodies, the insides of cells) have different priors:

- The *room* has the mean of the fit's recordings and their standard deviation; without a fit, the
  twin's value and the prior of the rig file. A recorded ambient temperature replaces it.
- The *plate* begins at the first readings of its channels.
- *Hidden states* begin between room and plate, as in the fit's recordings: see `_hidden_starts`.
- A rig *at rest* has equal plate and room temperatures. The difference between the two has a Cauchy
  prior, which pulls them together unless the readings contradict. It enters the least squares
  problem by reweighting (Holland and Welsch 1977).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..rig import Parameter, Rig
from ._hidden_starts import HiddenStarts, expected_distance
from ._linear_prior import LinearPrior
from ._starting_parameters import hidden_parameters, plate_parameters, room_parameters
from ._unknowns import Unknowns

REST_SCALE = 1.0
"""Scale of the Cauchy prior of the difference between plate and room, K."""

ROOM_DEVIATION = 2.0
"""Prior standard deviation of the room temperature between recordings, K. It counts as much as
`ROOM_WEIGHT` recordings."""

ROOM_WEIGHT = 1.0


def with_prior(
    row: Parameter, rig: Rig, first: float, earlier: Mapping[str, Mapping[str, float]]
) -> Parameter:
    """A parameter of a recording with its prior."""
    if row.name in plate_parameters(rig) | hidden_parameters(rig):
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
    rig: Rig,
    unknowns: Unknowns,
    first: float,
    room: float,
    hidden: HiddenStarts,
    *,
    is_estimated: bool,
) -> LinearPrior:
    """The prior of the distances of plate and hidden states from the room.

    **Arguments:**

    - `first`: the first reading, degC.
    - `room`: the room temperature, known or of the last round, degC.
    - `hidden`: what is known of hidden states.
    - `is_estimated`: whether the room temperature is among the unknowns.
    """
    names = [row.name for row in unknowns.per_recording]
    away = first - room
    priors = dict.fromkeys(plate_parameters(rig), (0.0, math.hypot(REST_SCALE, away)))
    priors |= {
        name: expected_distance(name, share, away, hidden.matched)
        for name, share in hidden.shares.items()
    }
    rows, values = [], []
    for name, (mean, standard_deviation) in priors.items():
        if name in names:
            row = np.zeros(len(names))
            row[names.index(name)] = 1 / standard_deviation
            if is_estimated:
                row[_room_entry(rig, names)] = -1 / standard_deviation
            rows.append(row)
            values.append((mean if is_estimated else mean + room) / standard_deviation)
    return LinearPrior(np.array(rows).reshape(-1, len(names)), np.array(values))


def _room_entry(rig: Rig, names: Sequence[str]) -> int:
    return next(names.index(name) for name in room_parameters(rig) if name in names)
