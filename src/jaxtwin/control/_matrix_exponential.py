"""The exponential of a matrix without LAPACK, for draws in several threads: see `_lapack`."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

TERMS = 18
"""The number of terms of the series: for a norm of at most a half, the remainder is below 1e-21."""

MOST_SQUARINGS = 40


def matrix_exponential(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The Taylor series of the scaled matrix, squared repeatedly."""
    unit = jnp.eye(len(matrix), dtype=matrix.dtype)
    norm = jax.lax.stop_gradient(jnp.abs(matrix).sum(axis=0).max())
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30))) + 1, 0, MOST_SQUARINGS)
    scaled = matrix / 2**halvings
    series = unit
    for term in range(TERMS, 0, -1):
        series = unit + scaled @ series / term

    def square(power: Array, number: Array) -> tuple[Array, None]:
        return jnp.where(number < halvings, power @ power, power), None

    return jax.lax.scan(square, series, jnp.arange(MOST_SQUARINGS))[0]
