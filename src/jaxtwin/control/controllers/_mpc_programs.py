"""The two quadratic programs of a sample of an `MPC`: the plan, and the duty at rest it aims at."""

from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._quadratic_program import QuadraticProgram
from ._condensed_program import Condensed, EvenPoints, SoftLimits, rest_cost
from ._evenness import AbstractEvennessCost

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
