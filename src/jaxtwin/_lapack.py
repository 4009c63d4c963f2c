"""Eigenvalues and solutions of small dense systems, of many draws from several threads at once.

On a CPU, XLA distributes the matrices of a batch over the thread pool on which it runs itself, and
waits there for the last of them. Two such calls at the same time on two cores wait for each other
for ever, and a call during a long computation waits for its end (seen with jax 0.10.2). Therefore
the matrices are solved one after the other in the calling thread, and draws are distributed over
the cores in chunks.

An accelerator gets the matrices of a batch at once. Of CUDA's two algorithms for eigenvalues only
Jacobi's takes a whole batch. The other, which JAX chooses above 32 rows, would solve the matrices
one after the other.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float


@custom_vmap
def eigh(matrix: Float[Array, "n n"]) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Eigenvalues, smallest first, and eigenvectors (columns) of a symmetric matrix."""
    values, vectors = jnp.linalg.eigh(matrix)
    return values, vectors


@custom_vmap
def solve_definite(matrix: Float[Array, "n n"], right: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Solves `matrix @ x = right` for a symmetric positive definite matrix. For any other matrix
    the result is NaN. The function has no derivatives."""
    return jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(matrix), True), right)


def solve(matrix: Float[Array, "n n"], right: Float[Array, "n *m"]) -> Float[Array, "n *m"]:
    """Solves `matrix @ x = right`; differentiable in both."""
    return jax.lax.custom_linear_solve(
        lambda x: matrix @ x,
        right,
        solve=lambda _, b: _solve(jax.lax.stop_gradient(matrix), b),
        transpose_solve=lambda _, b: _solve(jax.lax.stop_gradient(matrix).T, b),
    )


@custom_vmap
def _solve(matrix: Array, right: Array) -> Array:
    return jnp.linalg.solve(matrix, right)


def _eigh_by_jacobi(matrix: Array) -> tuple[Array, Array]:
    jacobi = jax.lax.linalg.EighImplementation.JACOBI
    vectors, values = jax.lax.linalg.eigh(matrix, implementation=jacobi)
    return values, vectors


def _one_by_one(
    call: custom_vmap,
    at_once: Callable[..., Any],
    size: object,  # an int, or a symbol while jax.export writes a batch of any size
    batched: list[bool],
    *given: Array,
) -> Any:
    """The rule for `vmap`: the matrices are solved one after the other on a CPU, and all at once on
    an accelerator."""
    rows = [
        array if is_batched else jnp.broadcast_to(array, (size, *array.shape))
        for array, is_batched in zip(given, batched, strict=True)
    ]
    result = jax.lax.platform_dependent(
        *rows,
        # The call has this rule itself, which therefore applies to a batch of batches too.
        cpu=lambda *rows: jax.lax.map(lambda row: call(*row), rows),
        default=jax.vmap(at_once),
    )
    return result, jax.tree.map(lambda _: True, result)


eigh.def_vmap(partial(_one_by_one, eigh, _eigh_by_jacobi))
_solve.def_vmap(partial(_one_by_one, _solve, _solve.fun))
solve_definite.def_vmap(partial(_one_by_one, solve_definite, solve_definite.fun))
