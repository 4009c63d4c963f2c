"""The two quadratic programs of a sample of an `MPC`: the plan, and the duty at rest it aims at."""

from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._condensed_program import Condensed, SoftLimits, rest_cost
from ._quadratic_program import QuadraticProgram

Limits: TypeAlias = tuple[Float[Array | np.ndarray, " cells"], Float[Array | np.ndarray, " cells"]]
"""The lowest and the highest duty of each cell, as deviations from the operating point."""


def plan_program(
    cost: Condensed,
    states: Float[Array, " state"],
    last_duty: Float[Array, " cells"],
    targets: Float[Array, " moves"],
    limits: Limits,
    reach: float | None,
    soft: SoftLimits | None,
    errors: Float[Array, " watched"],
) -> QuadraticProgram:
    """Makes the program whose minimum is the duty of the horizon, `(samples, cells)` in a row, as
    deviations from the operating point.

    **Arguments:**

    - `states`: the states after a reading. `last_duty`: the duty until now.
    - `targets`: the duty at rest for the reference of each sample of the horizon.
    - `reach`: the largest change of the duty in a sample; None for any.
    - `errors`: the errors of the model at the channels with limits, K.
    """
    slope = jnp.asarray(cost.by_states) @ states + jnp.asarray(cost.by_last_duty) @ last_duty
    slope = slope + jnp.asarray(cost.by_target) @ targets
    cells = len(last_duty)
    matrix = jnp.eye(len(slope), dtype=slope.dtype)
    low, high = (jnp.tile(limit, len(slope) // cells) for limit in limits)
    if reach is not None:
        changes = matrix - jnp.eye(len(slope), k=-cells, dtype=slope.dtype)
        last = jnp.zeros_like(slope).at[:cells].set(last_duty)
        matrix = jnp.concatenate([matrix, changes])
        low = jnp.concatenate([low, last - reach])
        high = jnp.concatenate([high, last + reach])
    softness: Any = 0.0
    if soft is not None:
        lasting = jnp.tile(errors, len(soft.lowest) // len(errors))
        coming = jnp.asarray(soft.by_states) @ states + lasting
        softness = _softness(soft, low, coming)
        matrix = jnp.concatenate([matrix, jnp.asarray(soft.by_moves)])
        low = jnp.concatenate([low, soft.lowest - coming])
        high = jnp.concatenate([high, soft.highest - coming])
    return QuadraticProgram(jnp.asarray(cost.hessian), slope, matrix, low, high, softness)


def rest_program(
    gain: Float[Array, "outputs cells"],
    inverse: Float[Array, "cells outputs"],
    accepted: Float[Array, " outputs"],
    missing: Float[Array, " outputs"],
    heat: Float[Array, " cells"],
    limits: Limits,
    soft: SoftLimits | None,
    errors: Float[Array, " watched"],
) -> QuadraticProgram:
    """Makes the program whose minimum is the smallest duty that changes the outputs at rest by a
    given amount. If the limits exclude it, the minimum is the nearest duty, in units of the
    accepted deviations.

    **Arguments:**

    - `gain`, `inverse`: the outputs at rest, K per unit of duty, and the smallest duty that changes
      them by 1 K.
    - `accepted`: the accepted deviations of the outputs, K.
    - `missing`: the change of the outputs, K. `heat`: the disturbance, as a duty.
    - `errors`: the errors of the model at the channels with limits, K.
    """
    scaled, hessian = map(jnp.asarray, rest_cost(gain, inverse, accepted))
    low, high = map(jnp.asarray, limits)
    matrix, softness = jnp.eye(len(low), dtype=hessian.dtype), 0.0
    if soft is not None:
        rows = len(soft.rest_gain)
        coming = jnp.asarray(soft.rest_gain) @ heat + errors
        matrix = jnp.concatenate([matrix, jnp.asarray(soft.rest_gain)])
        softness = _softness(soft, low, coming)
        low = jnp.concatenate([low, soft.lowest[:rows] - coming])
        high = jnp.concatenate([high, soft.highest[:rows] - coming])
    return QuadraticProgram(hessian, -scaled.T @ (missing / accepted), matrix, low, high, softness)


def _softness(limits: SoftLimits, hard: Array, soft: Array) -> Array:
    """The softness of all limits, 0 for the hard ones."""
    accepted = jnp.asarray(limits.excess, soft.dtype) ** 2
    return jnp.concatenate([jnp.zeros_like(hard), jnp.full_like(soft, accepted)])
