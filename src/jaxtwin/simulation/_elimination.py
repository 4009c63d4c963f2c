"""Gauss-Jordan elimination as one loop: a tenth of the code of a call of LAPACK's general solver.

XLA expands that call into a factorisation, a loop that converts its row swaps into a permutation,
and two triangular solves. Each such call takes half a second to compile.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def eliminate(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solves `matrix @ x = right` for a matrix of a few rows. The pivots are the largest entries of
    the columns."""
    rows = jnp.arange(right.size)

    def clear_column(
        k: Int[Array, ""], table: Float[Array, "n columns"]
    ) -> Float[Array, "n columns"]:
        left = jnp.where(rows >= k, jnp.abs(table[:, k]), -1.0)
        largest = jnp.argmax(left)
        pivot_row = table[largest]
        table = jnp.where((rows == largest)[:, None], table[k], table)
        pivot_row = pivot_row / pivot_row[k]
        cleared = table - table[:, k, None] * pivot_row
        return jnp.where((rows == k)[:, None], pivot_row, cleared)

    table = jnp.concatenate([matrix, right[:, None]], axis=1)
    return jax.lax.fori_loop(0, right.size, clear_column, table)[:, -1]
