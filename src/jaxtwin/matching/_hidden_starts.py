r"""The prior of a state that no reading shows at the start: a sink, a wall, the inside of a heater.

Such a state begins somewhere between the room and the plate, and no first reading tells where. Let
$a$ be the distance of the first reading from the room, and $d$ that of the hidden state. They are
taken as related by a line,

$$d_i = c + \beta a_i + e_i, \qquad c \sim N(0, \sigma_c^2), \quad
\beta \sim N(\beta_0, \sigma_\beta^2), \quad e_i \sim N(0, \tau^2),$$

with $\beta_0$ and $\sigma_\beta$ from the network (see `_starting_shares`), and the same $c$ and
$\beta$ in all recordings $i$ of the rig. The starts that a match found in its
recordings, each with its standard error, say more about both; the prior of a new recording is the
prediction of this normal model (Bayesian linear regression). Few recordings thus leave a wide
prior, and recordings that began like the new one a narrow one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from ._fit import Fit, solution_of
from ._starting_parameters import room_temperature
from ._starting_shares import Share

OFFSET = 1.0
"""Standard deviation of the offset, K."""

DEVIATION = 1.0
"""Prior standard deviation of a recording about the line, K. It counts as much as one recording."""


@final
@dataclass(frozen=True)
class MatchedStart:
    """How a matched recording began.

    - `room`, `reading`: the room temperature and the first reading, degC.
    - `values`: name -> temperature at the start as matched, degC. `variances`: their variances,
      K^2.
    """

    room: float
    reading: float
    values: Mapping[str, float]
    variances: Mapping[str, float]


class Expected(NamedTuple):
    """The expected distance of a hidden state from the room, K, and its standard deviation."""

    mean: float
    standard_deviation: float


class HiddenStarts(NamedTuple):
    """What is known of hidden states before a recording: the share of the plate's distance from the
    room of each, and the beginnings of matched recordings."""

    shares: Mapping[str, Share]
    matched: Sequence[MatchedStart]


def matched_starts(fit: Fit) -> tuple[MatchedStart, ...]:
    """The beginnings of a fit's recordings, of which it knows the room temperature."""
    rig, unknowns = fit.twin.rig, solution_of(fit).problem.unknowns
    variances = np.nan_to_num(np.diag(fit.uncertainty.vector_covariance), nan=math.inf)
    own = [row.name for row in unknowns.per_recording]
    indices = unknowns.layout.entry_indices()
    places = indices[:, indices.shape[1] - len(own) :]
    starts = []
    for name, first, entries in zip(fit.recordings, fit.first_samples, places, strict=True):
        starts.append(
            MatchedStart(
                room=room_temperature(rig, fit.twins[name].numbers_si, first.ambient),
                reading=first.reading,
                values=fit.recording_values[name],
                variances=dict(zip(own, variances[entries].tolist(), strict=True)),
            )
        )
    return tuple(starts)


def expected_distance(
    name: str, share: Share, away: float, matched: Sequence[MatchedStart]
) -> Expected:
    """The distance of a hidden state from the room at the start of a new recording.

    **Arguments:**

    - `name`: the parameter of that state.
    - `away`: the distance of the new recording's first reading from its room, K.
    - `matched`: the beginnings of other recordings of the rig.
    """
    known = [
        start
        for start in matched
        if name in start.values and math.isfinite(start.variances.get(name, math.inf))
    ]
    distances = np.array([start.values[name] - start.room for start in known])
    plate = np.array([*(start.reading - start.room for start in known), away])
    errors = np.array([start.variances[name] for start in known])
    beyond = distances - share.mean * plate[:-1]
    weights = DEVIATION**2 / (DEVIATION**2 + errors)
    spread = float(np.sum(weights * (beyond - beyond.mean()) ** 2)) if len(known) else 0.0
    variance = (DEVIATION**2 + spread) / (1 + max(0, len(known) - 1))
    covariance = (
        OFFSET**2
        + share.standard_deviation**2 * np.outer(plate, plate)
        + np.diag([*(variance + errors), variance])
    )
    gain = np.linalg.solve(covariance[:-1, :-1], covariance[:-1, -1])
    return Expected(
        mean=share.mean * away + float(gain @ beyond),
        standard_deviation=math.sqrt(float(covariance[-1, -1] - gain @ covariance[:-1, -1])),
    )
