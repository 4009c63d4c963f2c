"""Small dense systems by LAPACK: eigenvalues and solutions, from several threads at once.

On a CPU, XLA distributes the matrices of a batch over the thread pool on which it runs itself, and
waits there for the last of them. Two such calls at the same time on two cores wait for each other
for ever, and a call during a long computation waits for its end (seen with jax 0.10.2). Therefore
the matrices are solved one after the other in the calling thread, and draws are distributed over
the cores in chunks.

An accelerator gets the matrices of a batch at once. Of CUDA's two algorithms for eigenvalues only
Jacobi's takes a whole batch. The other, which JAX chooses above 32 rows, would solve the matrices
one after the other.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from threading import Lock
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


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


# One thread for the products of NumPy and SciPy.
#
# The matrices of a match are tall and narrow. OpenBLAS divides each product among threads that wait
# for each other busily: a match of `dual-cell` then takes a third more time on an idle machine, and
# several times as much beside other work. The recordings of a match have threads already.
#
# threadpoolctl finds the libraries and their functions, whose names differ from build to build.

_lock = Lock()
_inside = 0
_original_limits = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limits BLAS to one thread inside the block.

    The number of threads belongs to the process. Blocks of several threads may overlap; the number
    of before returns with the end of the last.
    """
    global _inside, _original_limits
    with _lock:
        if _inside == 0:
            _original_limits = _controller().limit(limits=1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _original_limits is not None:
                _original_limits.restore_original_limits()


@cache
def _controller() -> "ThreadpoolController":
    import scipy.linalg  # noqa: F401  # SciPy has a BLAS of its own, which must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
