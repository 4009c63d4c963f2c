r"""Priors of the states in which a recording begins.

Room, plate and hidden states (sinks, bodies, the insides of cells) have different priors:

- The *room* has the mean of the fit's recordings and their standard deviation; without a fit, the
  twin's value and the prior of the rig file. A recorded ambient temperature replaces it.
- The *plate* begins at the first readings of its channels.
- A rig *at rest* has equal plate and room temperatures. The difference between the two has a Cauchy
  prior, which pulls them together unless the readings contradict. It enters the least squares
  problem by reweighting (Holland and Welsch 1977).
- *Hidden states* begin somewhere between the room and the plate, and no first reading tells where.

Let $a$ be the distance of the first reading from the room, and $d$ that of a hidden state. They are
taken as related by a line,

$$d_i = c + \beta a_i + e_i, \qquad c \sim N(0, \sigma_c^2), \quad
\beta \sim N(\beta_0, \sigma_\beta^2), \quad e_i \sim N(0, \tau^2),$$

with the same $c$ and $\beta$ in all recordings $i$ of the rig. The starts that a match found in its
recordings, each with its standard error, say more about both; the prior of a new recording is the
prediction of this normal model (Bayesian linear regression). Few recordings thus leave a wide
prior, and recordings that began like the new one a narrow one.

$\beta_0$ and $\sigma_\beta$ follow from the network of the twin. What happened before a recording
is not known. It is described by heat that flows at random into the sides of the cells, equally at
all frequencies (white noise). The network with heat capacities $C$ and conductances $G$ answers
with temperatures whose covariance $P$ solves a Lyapunov equation,

$$G P C + C P G = Q,$$

in closed form in the network's modes. If the mean reading is $w^T T$ and the state $h^T T$, then

$$\beta_0 = \frac{h^T P w}{w^T P w}, \qquad
\sigma_\beta^2 = \frac{h^T P h}{w^T P w} - \beta_0^2.$$

The size of the random heat cancels. A wall that takes hours thus begins near the room, a heater
that takes seconds near the plate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..physics import Twin
from ..rig import Parameter, Rig
from ._fit import Fit, solution_of
from ._problem import LinearPrior
from ._start import hidden_parameters, plate_parameters, room_parameters, room_temperature
from ._unknowns import Unknowns

# Scale of the Cauchy prior of the difference between plate and room, K.
REST_SCALE = 1.0

# Prior standard deviation of the room temperature between recordings, K. It counts as much as
# `ROOM_WEIGHT` recordings.
ROOM_DEVIATION = 2.0

ROOM_WEIGHT = 1.0

# Standard deviation of the offset, K.
OFFSET_DEVIATION = 1.0

# Prior standard deviation of a recording about the line, K. It counts as much as one recording.
LINE_DEVIATION = 1.0

# The rise above the room at which nonlinear losses are linearised, K.
LINEARISED_AT = 10.0


class Share(NamedTuple):
    """The share of the plate's distance from the room that a state is expected to have at the
    start, with its standard deviation."""

    mean: float
    standard_deviation: float


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
    weights = LINE_DEVIATION**2 / (LINE_DEVIATION**2 + errors)
    spread = float(np.sum(weights * (beyond - beyond.mean()) ** 2)) if len(known) else 0.0
    variance = (LINE_DEVIATION**2 + spread) / (1 + max(0, len(known) - 1))
    covariance = (
        OFFSET_DEVIATION**2
        + share.standard_deviation**2 * np.outer(plate, plate)
        + np.diag([*(variance + errors), variance])
    )
    gain = np.linalg.solve(covariance[:-1, :-1], covariance[:-1, -1])
    return Expected(
        mean=share.mean * away + float(gain @ beyond),
        standard_deviation=math.sqrt(float(covariance[-1, -1] - gain @ covariance[:-1, -1])),
    )


@final
class _Network(NamedTuple):
    """The linear network: heat capacities, conductances, the weights of the nodes in the mean
    reading, and the derivatives of the temperatures at the start with respect to parameters."""

    capacitance: Float[Array, " nodes"]
    conductance: Float[Array, "nodes nodes"]
    reading: Float[Array, " nodes"]
    starts: Float[Array, "nodes parameters"]


def starting_shares(twin: Twin, names: Sequence[str]) -> dict[str, Share]:
    """The shares of states whose temperatures at the start are parameters.

    **Arguments:**

    - `names`: the parameters.
    """
    if not names:
        return {}
    values = np.array([float(twin.values[name]) for name in names])
    with own_settings():
        network = _network(twin, tuple(names), jnp.asarray(values))
    covariance = _covariance(network, np.concatenate([twin.wiring.cold, twin.wiring.hot]))
    reading = np.asarray(network.reading)
    of_reading = float(reading @ covariance @ reading)
    shares = {}
    for name, moved in zip(names, np.asarray(network.starts).T, strict=True):
        state = moved / moved.sum()
        mean = float(state @ covariance @ reading) / of_reading
        variance = float(state @ covariance @ state) / of_reading - mean**2
        shares[name] = Share(mean, float(np.sqrt(max(variance, 0.0))))
    return shares


@persistent_jit_unoptimised
def _network(twin: Twin, names: tuple[str, ...], values: Float[Array, " parameters"]) -> _Network:
    """The linear network about a uniform rise above the room."""
    system = twin.system(lumped=False)
    room, duty = system.ambient_temperature, jnp.zeros(len(twin.rig.driven))

    def heat(deviation: Array) -> Array:
        return system.heat_into_nodes(deviation, duty, room)

    def starts(values: Array) -> Array:
        started = twin.with_values(dict(zip(names, values, strict=True)))
        return started.system(lumped=False).initial_temperature

    slopes = jax.jacfwd(heat)(jnp.full_like(system.capacitance, LINEARISED_AT))
    reading = jnp.asarray(system.channel_weights).mean(axis=0)
    return _Network(system.capacitance, -slopes, reading, jax.jacfwd(starts)(values))


def _covariance(
    network: _Network, heated: Int[np.ndarray, " sides"]
) -> Float[np.ndarray, "nodes nodes"]:
    """The stationary covariance of the nodes' temperatures under independent white heat into some
    nodes, up to a factor."""
    root = 1 / np.sqrt(np.asarray(network.capacitance))
    scaled = root[:, None] * np.asarray(network.conductance) * root
    # Without current through the cells the network is symmetric, up to rounding.
    rates, modes = np.linalg.eigh((scaled + scaled.T) / 2)
    drive = modes[heated].T * root[heated]
    shapes = root[:, None] * modes
    return shapes @ (drive @ drive.T / np.add.outer(rates, rates)) @ shapes.T
