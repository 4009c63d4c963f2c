"""The two quadratic programs of a sample of an `MPC`: the plan, condensed to the duty of the
horizon, and the duty at rest that it aims at, which may be that of the most even temperatures."""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import block_diag

from ..._arguments import finite_number
from ..._quadratic_program import QuadraticProgram
from ...errors import ControlError
from ..linear._riccati import regulator
from ..linear._state_space import StateSpace

# The program of a model predictive controller, condensed to the duty of the horizon.
#
# The states of the next $n$ samples are linear functions of the present states and of the planned
# duty, the moves. Eliminating the states leaves a quadratic program whose only unknowns are the
# moves. Its matrices are computed once, when a controller is designed.


class Condensed(NamedTuple):
    """The cost as a function of only the moves, `(samples, cells)` in a row: its Hessian, and the
    matrices by which states, last duty and targets enter its gradient."""

    hessian: Float[Array | np.ndarray, "moves moves"]
    by_states: Float[Array | np.ndarray, "moves state"]
    by_last_duty: Float[Array | np.ndarray, "moves cells"]
    by_target: Float[Array | np.ndarray, "moves targets"]


class Deviations(NamedTuple):
    """The accepted deviations of the outputs, K, of the duty, and of its change."""

    output: Float[Array | np.ndarray, " outputs"]
    duty: Float[Array | np.ndarray, " cells"]
    change: Float[Array | np.ndarray, " cells"]


class SoftLimits(NamedTuple):
    """The temperatures of the limited channels in the samples of the horizon, `(samples, channels)`
    in a row, as deviations from the operating point: by the states and by the moves, with their
    limits.

    - `rest_gain`: the temperatures of the channels at rest, K per unit of duty.
    """

    by_states: Float[Array | np.ndarray, "rows state"]
    by_moves: Float[Array | np.ndarray, "rows moves"]
    lowest: Float[Array | np.ndarray, " rows"]
    highest: Float[Array | np.ndarray, " rows"]
    rest_gain: Float[Array | np.ndarray, "limited cells"]


class EvenPoints(NamedTuple):
    """The temperatures that are to be even, as `SoftLimits` has those of limited channels.

    - `C`, `at`: their matrix, and their temperatures at the operating point, degC.
    - `beyond`: the same from the mean of the outputs there on, K.
    - `by_errors`: how the errors of the model at the watched channels change them.
    """

    by_states: Float[Array | np.ndarray, "rows state"]
    by_moves: Float[Array | np.ndarray, "rows moves"]
    rest_gain: Float[Array | np.ndarray, "points cells"]
    C: Float[Array | np.ndarray, "points state"]
    at: Float[Array | np.ndarray, " points"]
    beyond: Float[Array | np.ndarray, " points"]
    by_errors: Float[Array | np.ndarray, "points watched"]


class WatchedChannels(NamedTuple):
    """The channels that are read beside the outputs, first those with limits.

    - `C`, `at`: their matrix, and their readings at the operating point, degC.
    - `L`: the gain of the filter of the errors of the model there, see `error_gain`.
    - `unexplained`: what is left of errors there after the disturbances of the Kalman filter. If it
      reads these channels itself, its disturbances take what the cells could have done.
    """

    C: Float[Array | np.ndarray, "watched state"]
    at: Float[Array | np.ndarray, " watched"]
    L: Float[Array | np.ndarray, " watched"]
    unexplained: Float[Array | np.ndarray, "watched watched"]


class PredictedStates(NamedTuple):
    """The states of the samples from 1 to the horizon, as matrices that multiply the present states
    and disturbances, and the moves."""

    by_states: Float[np.ndarray, "samples n state"]
    by_moves: Float[np.ndarray, "samples n moves"]


def predict(
    plant: StateSpace,
    to_duty: Float[np.ndarray, "cells disturbances"],
    horizon: int,
    control_horizon: int,
) -> PredictedStates:
    """Computes the states over a horizon, given in samples. From the last sample of the control
    horizon on, the duty is held.

    **Arguments:**

    - `to_duty`: `disturbance_to_duty` of the `KalmanFilter`, 1/K.
    """
    (n, cells), unknown = plant.B.shape, to_duty.shape[1]
    by_disturbance = plant.B @ to_duty @ np.eye(unknown, n + unknown, n)
    state, moved = np.eye(n, n + unknown), np.zeros((n, control_horizon * cells))
    by_states, by_moves = [], []
    for sample in range(horizon):
        move = min(sample, control_horizon - 1)
        this = np.eye(cells, control_horizon * cells, move * cells)
        state = plant.A @ state + by_disturbance
        moved = plant.A @ moved + plant.B @ this
        by_states.append(state)
        by_moves.append(moved)
    return PredictedStates(np.array(by_states), np.array(by_moves))


def condense(
    plant: StateSpace,
    to_duty: Float[np.ndarray, "cells disturbances"],
    predicted: PredictedStates,
    deviations: Deviations,
    tracked: StateSpace | None = None,
) -> Condensed:
    r"""Condenses the cost to a function of the moves.

    With $\xi = (x, u_{-1})$, deviations from the point where the plate comes to rest, and the input
    $\Delta u$, the problem is that of a regulator, and the cost beyond the horizon is its Riccati
    cost.

    **Arguments:**

    - `to_duty`: as in `predict`.
    - `tracked`: the model of points whose mean square deviation from their temperatures at rest is
      a part of the cost, with the accepted deviation of the outputs; None for none.

    **Raises:** `ControlError` if the plant has no stable design.
    """
    (n, cells), unknown = plant.B.shape, to_duty.shape[1]
    horizon, _, moves = predicted.by_moves.shape
    y, u, change = (np.asarray(deviation, float) for deviation in deviations)
    unit = np.eye(cells)
    A = np.block([[plant.A, plant.B], [np.zeros((cells, n)), unit]])
    B = np.vstack([plant.B, unit])
    of_outputs = plant.C.T @ np.diag(y**-2.0) @ plant.C
    if tracked is not None:
        of_outputs += tracked.C.T @ tracked.C / (len(tracked.C) * np.mean(y**2))
    Q = np.asarray(block_diag(of_outputs, np.diag(u**-2.0)))
    _, P = regulator("MPC", A, B, Q, np.diag(change**-2.0))
    # Row k of each: (x_k, u_{k-1}) for k = 1 to the horizon, by the states and by the moves.
    held = np.minimum(np.arange(horizon), moves // cells - 1)
    duty = np.eye(moves).reshape(-1, cells, moves)[held]
    no_states = np.zeros((horizon, cells, n + unknown))
    by_states = np.concatenate([predicted.by_states, no_states], axis=1).reshape(-1, n + unknown)
    E = np.concatenate([predicted.by_moves, duty], axis=1).reshape(-1, moves)
    W = np.asarray(block_diag(*[Q] * (horizon - 1), P))
    disturbance, steady = np.eye(unknown, n + unknown, n), plant.steady_states
    aim = np.vstack([steady, unit])  # (x, u) at rest per duty
    at_rest = np.vstack([steady @ to_duty @ disturbance, no_states[0]])
    differences = np.eye(moves) - np.eye(moves, k=-cells)
    S = np.diag(np.tile(change**-2.0, moves // cells))
    first = np.eye(moves, cells)
    hessian = E.T @ W @ E + differences.T @ S @ differences
    return Condensed(
        hessian=(hessian + hessian.T) / 2,
        by_states=E.T @ W @ (by_states - np.tile(at_rest, (horizon, 1))),
        by_last_duty=-differences.T @ S @ first,
        by_target=-E.T @ W @ np.asarray(block_diag(*[aim] * horizon)),
    )


def rest_cost(
    gain: Float[Array | np.ndarray, "outputs cells"],
    inverse: Float[Array | np.ndarray, "cells outputs"],
    accepted: Float[Array | np.ndarray, " outputs"],
    unseen_costs: bool = True,
) -> tuple[Float[Array | np.ndarray, "outputs cells"], Float[Array | np.ndarray, "cells cells"]]:
    """Computes the DC gain in units of the accepted deviations, and the Hessian of the cost of
    a duty at rest, in NumPy or JAX as the arrays are. What no output sees costs as much as what
    they see on average, or nothing."""
    scaled = gain / accepted[:, None]
    if not unseen_costs:
        return scaled, scaled.T @ scaled
    size = (scaled**2).sum() / len(gain)
    unseen = np.eye(gain.shape[1], dtype=gain.dtype) - inverse @ gain
    return scaled, scaled.T @ scaled + size * unseen


def soft_limits(
    limited: StateSpace, predicted: PredictedStates, limits: Float[np.ndarray, "limited 2"]
) -> SoftLimits:
    """Computes the predicted temperatures of the limited channels.

    **Arguments:**

    - `limited`: the model with these channels as its outputs.
    - `limits`: the lowest and the highest temperature of each channel, degC.
    """
    C, at = np.asarray(limited.C), np.asarray(limited.operating_point.outputs)
    lowest, highest = np.tile((limits - at[:, None]).T, len(predicted.by_states))
    gain = np.asarray(limited.dcgain)
    return SoftLimits(*_over_the_horizon(C, predicted), lowest, highest, gain)


def even_points(
    points: StateSpace,
    predicted: PredictedStates,
    by_errors: Float[np.ndarray, "points watched"],
    centre: float,
) -> EvenPoints:
    """Computes the predicted temperatures of the points that are to be even.

    **Arguments:**

    - `points`: the model with these points as its outputs.
    - `centre`: the mean of the controlled outputs at the operating point, degC.
    """
    C, at = np.asarray(points.C), np.asarray(points.operating_point.outputs)
    by_moves = _over_the_horizon(C, predicted)
    return EvenPoints(*by_moves, np.asarray(points.dcgain), C, at, at - centre, by_errors)


def _over_the_horizon(
    C: Float[np.ndarray, "temperatures state"], predicted: PredictedStates
) -> tuple[Float[np.ndarray, "rows estimated"], Float[np.ndarray, "rows moves"]]:
    states, moves = predicted.by_states.shape[2], predicted.by_moves.shape[2]
    return (
        (C @ predicted.by_states).reshape(-1, states),
        (C @ predicted.by_moves).reshape(-1, moves),
    )


# What makes temperatures uneven, as the cost of a model predictive controller.
#
# The outputs of an `MPC` keep their references. If there are more cells than outputs, many duty
# cycles do so at rest. The controller takes the one of the least cost $J(y)$, a convex function of
# the temperatures $y$ of many points, and then plans such that no point is farther off on the way
# than the farthest one will be at rest.


class AbstractEvennessCost(eqx.Module):
    """A convex cost of the temperatures of many points, K.

    With an `energy_price` a duty at rest costs what it draws, too: points that are less even by
    that many K are accepted if the sum of the duty cycles becomes smaller by 1.
    """

    name: ClassVar[str]
    """The name of the cost in controller files."""

    is_quadratic: ClassVar[bool] = False
    """Whether it is a sum of squares, and not the deviation of the points that are farthest off."""

    has_free_centre: ClassVar[bool] = False
    """Whether deviations are counted from a temperature that is free, and not from the
    reference."""

    energy_price: eqx.AbstractVar[float]

    def __check_init__(self) -> None:
        where = f"{type(self).__name__}: energy_price"
        finite_number(where, self.energy_price, ControlError, least=0, unit="K")


@final
class RangeCost(AbstractEvennessCost):
    r"""The difference between the hottest and the coldest point, $\max_i y_i - \min_i y_i$.

    **Arguments:**

    - `energy_price`: the range that a unit of duty is worth, K.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "range"
    has_free_centre: ClassVar[bool] = True
    energy_price: float = eqx.field(static=True, default=0.0)


@final
class WorstPointCost(AbstractEvennessCost):
    r"""Twice the deviation of the point that is farthest from the reference,
    $2 \max_i |y_i - r|$ (minimax).

    **Arguments:**

    - `energy_price`: as in `RangeCost`.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "worst-point"
    energy_price: float = eqx.field(static=True, default=0.0)


@final
class SquaresCost(AbstractEvennessCost):
    r"""The sum of the squared deviations from the reference, $\sum_i (y_i - r)^2 / 2 n$, in K by
    $n$ points. On the way each point is driven to its temperature at rest.

    **Arguments:**

    - `energy_price`: as in `RangeCost`.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "squares"
    is_quadratic: ClassVar[bool] = True
    energy_price: float = eqx.field(static=True, default=0.0)


# Name in controller files -> class.
EVENNESS_COSTS: Mapping[str, type[RangeCost] | type[WorstPointCost] | type[SquaresCost]] = {
    cost.name: cost for cost in (RangeCost, WorstPointCost, SquaresCost)
}


# The lowest and the highest duty of each cell, as deviations from the operating point.
Limits: TypeAlias = tuple[Float[Array | np.ndarray, " cells"], Float[Array | np.ndarray, " cells"]]

# The weight of the evenness at rest relative to the outputs. It moves them by millikelvins.
EVENNESS_WEIGHT = 1e-3

# The smallest deviation from their centre that points are planned with, K: a program needs room
# between its limits.
MIN_BAND = 0.01

# The largest deviation of a point from the centre, K: a limit that no plate reaches.
MAX_BAND = 1e3


# How far points may be from their centre on the way, relative to the farthest one at rest. A plate
# that rises has a larger range than one at rest at the same mean, so that without this room its
# last kelvin would take long.
ROOM_ON_THE_WAY = 1.03


class SoftTemperatures(NamedTuple):
    """The temperatures that a program limits softly, and those that it makes even.

    - `limits`, `points`: None for none.
    - `cost`: the cost of the points; None without points.
    - `excess`: the accepted excess of each channel with limits, and then of points, K.
    """

    limits: SoftLimits | None
    points: EvenPoints | None
    cost: AbstractEvennessCost | None
    excess: Float[Array | np.ndarray, " limited_and_points"]

    @property
    def limited(self) -> int:
        """The number of channels with limits."""
        return 0 if self.limits is None else len(self.limits.rest_gain)

    @property
    def has_bands(self) -> bool:
        """Whether the plan keeps the points together."""
        return self.cost is not None and not self.cost.is_quadratic


class Rest(NamedTuple):
    """The state of rest that a plan aims at in each sample of its horizon.

    - `duty`: its duty, as deviations from the operating point.
    - `deviation`: the largest deviation of a point from the centre, K.
    - `centre`: the mean of the references, as a deviation from that of the operating point, K.
    """

    duty: Float[Array, "samples cells"]
    deviation: Float[Array, " samples"]
    centre: Float[Array, " samples"]


def plan_program(
    cost: Condensed,
    states: Float[Array, " state"],
    last_duty: Float[Array, " cells"],
    rest: Rest,
    limits: Limits,
    reach: float | None,
    soft: SoftTemperatures,
    errors: Float[Array, " watched"],
) -> QuadraticProgram:
    """Makes the program whose minimum is the duty of the control horizon, `(samples, cells)` in a
    row, as deviations from the operating point.

    **Arguments:**

    - `states`: the states after a reading. `last_duty`: the duty until now.
    - `rest`: the state of rest for the reference of each sample of the horizon.
    - `reach`: the largest change of the duty in a sample; None for any.
    - `errors`: the errors of the model at the watched channels, K.
    """
    slope = jnp.asarray(cost.by_states) @ states + jnp.asarray(cost.by_last_duty) @ last_duty
    slope = slope + jnp.asarray(cost.by_target) @ rest.duty.reshape(-1)
    cells = len(last_duty)
    matrix = jnp.eye(len(slope), dtype=slope.dtype)
    low, high = (jnp.tile(limit, len(slope) // cells) for limit in limits)
    if reach is not None:
        changes = matrix - jnp.eye(len(slope), k=-cells, dtype=slope.dtype)
        last = jnp.zeros_like(slope).at[:cells].set(last_duty)
        matrix = jnp.concatenate([matrix, changes])
        low = jnp.concatenate([low, last - reach])
        high = jnp.concatenate([high, last + reach])
    hard, bands = len(low), None
    if soft.limits is not None:
        limited = soft.limits
        lasting = jnp.tile(errors[: soft.limited], len(rest.duty))
        coming = jnp.asarray(limited.by_states) @ states + lasting
        matrix = jnp.concatenate([matrix, jnp.asarray(limited.by_moves)])
        low = jnp.concatenate([low, limited.lowest - coming])
        high = jnp.concatenate([high, limited.highest - coming])
    if soft.points is not None and soft.has_bands:
        points, samples = soft.points, len(rest.duty)
        still = jnp.asarray(points.beyond) + jnp.asarray(points.by_errors) @ errors
        moving = (jnp.asarray(points.by_states) @ states).reshape(samples, -1)
        coming = moving + still
        by_moves = jnp.asarray(points.by_moves)
        if soft.cost is not None and soft.cost.has_free_centre:
            bands = by_moves.reshape(*coming.shape, -1)
        else:
            matrix = jnp.concatenate([matrix, by_moves])
            coming = coming - rest.centre[:, None]
        wide = jnp.maximum(rest.deviation, MIN_BAND)[:, None]
        low = jnp.concatenate([low, (-wide - coming).reshape(-1)])
        high = jnp.concatenate([high, (wide - coming).reshape(-1)])
    softness = _softness(soft, len(rest.duty), hard, len(low))
    return QuadraticProgram(jnp.asarray(cost.hessian), slope, matrix, low, high, softness, bands)


def rest_program(
    gain: Float[Array, "outputs cells"],
    inverse: Float[Array, "cells outputs"],
    accepted: Float[Array, " outputs"],
    missing: Float[Array, " outputs"],
    heat: Float[Array, " cells"],
    limits: Limits,
    soft: SoftTemperatures,
    errors: Float[Array, " watched"],
    centre: Float[Array, ""],
) -> QuadraticProgram:
    """Makes the program whose minimum is the smallest duty that changes the outputs at rest by a
    given amount, or, with points that are to be even, the one of the least cost. If the limits
    exclude it, the minimum is the nearest duty, in units of the accepted deviations.

    If a plan keeps the points together, the minimum has the largest deviation of a point from the
    centre after the duty.

    **Arguments:**

    - `gain`, `inverse`: the outputs at rest, K per unit of duty, and the smallest duty that changes
      them by 1 K.
    - `accepted`: the accepted deviations of the outputs, K.
    - `missing`: the change of the outputs, K. `heat`: the disturbance, as a duty.
    - `errors`: the errors of the model at the watched channels, K.
    - `centre`: as in `Rest`.
    """
    scaled, of_duty = map(jnp.asarray, rest_cost(gain, inverse, accepted, soft.points is None))
    slope = -scaled.T @ (missing / accepted)
    low, high = map(jnp.asarray, limits)
    cells, size, dtype = len(low), len(low) + soft.has_bands, of_duty.dtype
    hessian = jnp.zeros((size, size), dtype).at[:cells, :cells].set(of_duty)
    slope = jnp.zeros(size, dtype).at[:cells].set(slope)
    if soft.has_bands:
        low, high = (jnp.append(limit, end) for limit, end in ((low, 0.0), (high, MAX_BAND)))
    matrix, bands = jnp.eye(size, dtype=dtype), None
    softness = jnp.zeros(size, dtype)
    if soft.limits is not None:
        limited, rows = soft.limits, soft.limited
        by_rest = jnp.asarray(limited.rest_gain)
        coming = by_rest @ heat + errors[:rows]
        matrix = jnp.concatenate([matrix, _wider(by_rest, size)])
        softness = _softness(soft, 1, size, size + rows)
        low = jnp.concatenate([low, limited.lowest[:rows] - coming])
        high = jnp.concatenate([high, limited.highest[:rows] - coming])
    if soft.points is None or soft.cost is None:
        return QuadraticProgram(hessian, slope, matrix, low, high, softness)
    points = soft.points
    by_rest = jnp.asarray(points.rest_gain)
    coming = jnp.asarray(points.beyond) + by_rest @ heat + jnp.asarray(points.by_errors) @ errors
    slope = slope.at[:cells].add(EVENNESS_WEIGHT * soft.cost.energy_price)
    if not soft.has_bands:
        weight = EVENNESS_WEIGHT / len(coming)
        hessian = hessian + weight * by_rest.T @ by_rest
        slope = slope + weight * by_rest.T @ (coming - centre)
        return QuadraticProgram(hessian, slope, matrix, low, high, softness)
    slope = slope.at[cells].set(2 * EVENNESS_WEIGHT)
    sums = jnp.concatenate([_wider(by_rest, size, -1.0), _wider(by_rest, size, 1.0)])
    if soft.cost.has_free_centre:
        bands = sums[None]
    else:
        matrix, coming = jnp.concatenate([matrix, sums]), coming - centre
    wide = jnp.full_like(coming, MAX_BAND)
    low = jnp.concatenate([low, -wide, -coming])
    high = jnp.concatenate([high, -coming, wide])
    softness = jnp.concatenate([softness, jnp.zeros(2 * len(coming), dtype)])
    return QuadraticProgram(hessian, slope, matrix, low, high, softness, bands)


def squares_at_rest(soft: SoftTemperatures) -> Float[np.ndarray, "cells cells"] | None:
    """The Hessian of the squares of the points by a duty at rest; None for another cost."""
    if soft.points is None or soft.has_bands:
        return None
    by_rest = np.asarray(soft.points.rest_gain, float)
    return EVENNESS_WEIGHT / len(by_rest) * by_rest.T @ by_rest


def _wider(by_rest: Float[Array, "rows cells"], size: int, last: float = 0.0) -> Array:
    """Appends a column for the largest deviation, if it is an unknown."""
    column = jnp.full((len(by_rest), size - by_rest.shape[1]), last, by_rest.dtype)
    return jnp.concatenate([by_rest, column], axis=1)


def _softness(soft: SoftTemperatures, samples: int, hard: int, all_limits: int) -> Array:
    """The softness of all limits: 0 for the hard ones, which are the first, that of the channels
    with limits in each sample, and that of points."""
    accepted = jnp.asarray(soft.excess) ** 2
    of_channels = jnp.tile(accepted[:-1], samples)
    points = all_limits - hard - len(of_channels)
    none = jnp.zeros(hard, accepted.dtype)
    return jnp.concatenate([none, of_channels, jnp.full(points, accepted[-1])])
