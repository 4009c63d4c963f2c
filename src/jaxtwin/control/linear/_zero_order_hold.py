r"""Discretises a linear model under held commands, exactly with lag and delay.

The duty that reaches the cells is a state $v$ behind those of the model. While the same command $u$
arrives, the states $z$ change by

$$z(t + h) = e^{F h} z(t) + \int_0^h e^{F s} ds\, H u$$

With a delay of $(n + r) T_s$, $0 \le r < 1$, the command of $n + 1$ steps ago arrives for the first
$r T_s$ of a step, and that of $n$ steps ago for the rest.
"""

from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compilation import persistent_jit_unoptimised

Matrices: TypeAlias = tuple[Any, Any, Any, Any]

# Parts of a step below this are set to 0, so that a delay of n steps is a delay of n steps after
# rounding.
ROUNDING = 1e-9

# The number of terms of the series of a matrix exponential: for a norm of at most a half, the
# remainder is below 1e-21.
SERIES_TERMS = 18

# The largest number of squarings of a matrix exponential.
SQUARINGS = 40


@persistent_jit_unoptimised
def zero_order_hold(
    matrices: Matrices,
    delay: Float[Array | np.ndarray, ""],
    lag: Float[Array | np.ndarray, ""] | None,
    sample_time: Float[Array, ""],
    shifts: int,
) -> Matrices:
    """A, B, C and D of the discrete model, with states for the given number of commands in transit.

    **Arguments:**

    - `matrices`: A, B, C and D of the model.
    - `delay`, `lag`, `sample_time`: s.
    """
    F, H, output, direct = _lagged(matrices, lag)
    states, inputs = H.shape
    # Steps of the delay; the command of `whole` steps ago arrives after the rest.
    late = delay / sample_time if shifts else jnp.zeros((), F.dtype)
    whole = jnp.floor(late + ROUNDING)
    rest = jnp.maximum(late - whole, 0.0)
    rest = jnp.where(rest < ROUNDING, 0.0, rest) * sample_time
    A = matrix_exponential(F * sample_time)
    late_part, late_input = _moved(F, H, sample_time - rest)
    _, early_input = _moved(F, H, rest)
    early_input = late_part @ early_input
    # How much of each command, from the newest on, arrives during a step.
    age = jnp.arange(shifts + 1)
    by_age = (age == whole)[:, None, None] * late_input
    by_age += (age == whole + 1)[:, None, None] * early_input
    # What arrives at the sample time itself.
    arrived = (age == whole + (rest > 0))[:, None, None] * direct
    waiting = shifts * inputs
    top = jnp.concatenate([A, *by_age[1:]], axis=1)
    shift = jnp.eye(waiting, waiting, -inputs, dtype=F.dtype)
    bottom = jnp.concatenate([jnp.zeros((waiting, states), F.dtype), shift], axis=1)
    newest = jnp.eye(waiting, inputs, dtype=F.dtype)
    return (
        jnp.concatenate([top, bottom]),
        jnp.concatenate([by_age[0], newest]),
        jnp.concatenate([output, *arrived[1:]], axis=1),
        arrived[0],
    )


@persistent_jit_unoptimised
def integrated_rates(
    A: Float[Array, "state state"], rates: Float[Array, " state"], sample_time: Float[Array, ""]
) -> Float[Array, " state"]:
    """Computes the change of the states in a sample by a constant rate, K/s, K."""
    _, moved = _moved(A, rates[:, None], sample_time)
    return moved[:, 0]


def _lagged(matrices: Matrices, lag: Float[Array | np.ndarray, ""] | None) -> Matrices:
    """The model with the duty that reaches the cells among its states, if it lags."""
    A, B, C, D = (jnp.asarray(matrix) for matrix in matrices)
    if lag is None:
        return A, B, C, D
    states, inputs = B.shape
    follow = jnp.eye(inputs, dtype=A.dtype) / lag
    F = jnp.block([[A, B], [jnp.zeros((inputs, states)), -follow]])
    H = jnp.concatenate([jnp.zeros((states, inputs)), follow])
    return F, H, jnp.concatenate([C, D], axis=1), jnp.zeros_like(D)


def _moved(F: Array, H: Array, time: Array) -> tuple[Array, Array]:
    """The transition matrix of a time, and the effect of a command that is held for that time."""
    states, inputs = H.shape
    # Both follow from one exponential (Van Loan, IEEE Trans. Autom. Control 23, 1978).
    augmented = jnp.block([[F, H], [jnp.zeros((inputs, states + inputs))]])
    moved = matrix_exponential(augmented * time)
    return moved[:states, :states], moved[:states, states:]


def matrix_exponential(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The exponential of a matrix: the Taylor series of the scaled matrix, squared repeatedly.

    LAPACK is not used, because draws are computed in several threads: see `_lapack`.
    """
    unit = jnp.eye(len(matrix), dtype=matrix.dtype)
    norm = jax.lax.stop_gradient(jnp.abs(matrix).sum(axis=0).max())
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30))) + 1, 0, SQUARINGS)
    scaled = matrix / 2**halvings
    series = unit
    for term in range(SERIES_TERMS, 0, -1):
        series = unit + scaled @ series / term

    def square(power: Array, number: Array) -> tuple[Array, None]:
        return jnp.where(number < halvings, power @ power, power), None

    return jax.lax.scan(square, series, jnp.arange(SQUARINGS))[0]
