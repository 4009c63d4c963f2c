"""The Rosenbrock method Rodas5P as a diffrax solver."""

from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._sparse import SparseLU, sparse_jacobian
from ._rosenbrock_step import DENSE, GAMMA, NODES, SLOPE_TABLE, STATE_TABLE, TIME, step_matrix

RealScalarLike: TypeAlias = float | int | Float[Array | np.ndarray, ""]


def _factorisation(sparsity: Bool[np.ndarray, "n n"] | SparseLU | None) -> SparseLU | None:
    return SparseLU(sparsity) if isinstance(sparsity, np.ndarray) else sparsity


@final
class RodasInterpolation(diffrax.AbstractLocalInterpolation):
    """The continuous output of Rodas5P within a step, of fourth order; see `DENSE`."""

    t0: RealScalarLike  # pyright: ignore[reportIncompatibleVariableOverride]
    t1: RealScalarLike  # pyright: ignore[reportIncompatibleVariableOverride]
    y0: PyTree[Array]
    y1: PyTree[Array]
    polynomials: PyTree[Array]

    def evaluate(
        self, t0: RealScalarLike, t1: RealScalarLike | None = None, left: bool = True
    ) -> PyTree[Array]:
        """The solution at `t0`, or its change from `t0` to `t1`."""
        del left
        if t1 is not None:
            return jax.tree.map(lambda a, b: b - a, self.evaluate(t0), self.evaluate(t1))
        length = jnp.asarray(self.t1 - self.t0)
        s = jnp.asarray(t0 - self.t0) / jnp.where(length == 0, 1.0, length)

        def at(y0: Array, y1: Array, p: Array) -> Array:
            return (1 - s) * y0 + s * (y1 + (1 - s) * (p[0] + s * (p[1] + s * p[2])))

        return jax.tree.map(at, self.y0, self.y1, self.polynomials)


@final
class Rodas5P(diffrax.AbstractAdaptiveSolver):
    r"""The Rosenbrock method Rodas5P of G. Steinebach (BIT Numer. Math. 63 (2023) 27), for stiff
    equations: L-stable, of order five, with an embedded solution and continuous output of order
    four.

    A step solves eight linear systems with one matrix and iterates nothing. It needs no root finder
    and no tolerance but that of the step size controller, and its derivatives are exact.

    ```python
    solver = Rodas5P(sparsity=np.eye(3, dtype=bool))
    diffrax.diffeqsolve(diffrax.ODETerm(field), solver, ...)
    ```

    With a `sparsity`, the Jacobian is found from a few directional derivatives, and factorised by a
    sequence of elementwise operations (`_sparse_lu`). `jax.vmap` of a solve then makes no batch of
    small matrices for a library: each operation acts on all members of the batch at once.

    **Not suitable** with a `sparsity` for a matrix $I / (\gamma h) - J$ whose diagonal is not
    large, because its rows are not exchanged; leave `sparsity` out then.

    **Arguments:**

    - `sparsity` (n, n): a NumPy array, whether each entry of the Jacobian
      $\partial f_i / \partial y_j$ may differ from 0, for the n numbers of the state in the order
      of `jax.flatten_util.ravel_pytree`; None for a full matrix with pivoting.
    """

    sparsity: SparseLU | None = eqx.field(static=True, default=None, converter=_factorisation)

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar[Callable[..., Any]] = RodasInterpolation

    def order(self, terms: diffrax.AbstractTerm) -> int:
        """Five."""
        del terms
        return 5

    def init(
        self,
        terms: diffrax.AbstractTerm,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: PyTree[Array],
        args: PyTree,
    ) -> None:
        """There is nothing to keep from step to step."""
        del terms, t0, t1, y0, args

    def step(
        self,
        terms: diffrax.AbstractTerm,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: PyTree[Array],
        args: PyTree,
        solver_state: None,
        made_jump: object,
    ) -> tuple[Any, Any, dict[str, Any], None, diffrax.RESULTS]:
        """Takes a step."""
        del solver_state, made_jump
        start, unravel = ravel_pytree(y0)
        size = jnp.asarray(t1 - t0, start.dtype)

        def field(t: RealScalarLike, y: Array) -> Array:
            return ravel_pytree(terms.vf(t, unravel(y), args))[0].astype(start.dtype)

        t0 = jnp.asarray(t0)
        time_slope = jax.jvp(lambda t: field(t, start), (t0,), (jnp.ones_like(t0),))[1]
        solve = _solver(lambda y: field(t0, y), start, size, self.sparsity)
        states, slopes, nodes, times = (
            jnp.asarray(table, start.dtype) for table in (STATE_TABLE, SLOPE_TABLE, NODES, TIME)
        )

        # A loop, because compilers take minutes for eight copies of an unrolled solution.
        def stage(number: Int[Array, ""], stages: Float[Array, "8 n"]) -> Float[Array, "8 n"]:
            slope = field(t0 + nodes[number] * size, start + states[number] @ stages)
            right = slope + slopes[number] @ stages / size + times[number] * size * time_slope
            return stages.at[number].set(solve(right))

        stages = jax.lax.fori_loop(
            0, len(NODES), stage, jnp.zeros((len(NODES), start.size), start.dtype)
        )
        last = start + states[-1] @ stages
        error = stages[-1]
        end = last + error
        polynomials = jax.vmap(unravel)(jnp.asarray(DENSE, start.dtype) @ stages)
        dense = {"y0": y0, "y1": unravel(end), "polynomials": polynomials}
        return unravel(end), unravel(error), dense, None, diffrax.RESULTS.successful

    def func(
        self, terms: diffrax.AbstractTerm, t0: RealScalarLike, y0: PyTree[Array], args: PyTree
    ) -> PyTree[Array]:
        """The vector field."""
        return terms.vf(t0, y0, args)


def _solver(
    field: Callable[[Array], Array],
    start: Float[Array, " n"],
    size: Float[Array, ""],
    lu: SparseLU | None,
) -> Callable[[Float[Array, " n"]], Float[Array, " n"]]:
    """The solution of systems with the matrix of a step."""
    if lu is None:
        identity = jnp.eye(start.size, dtype=start.dtype) / (GAMMA * size)
        whole = jax.scipy.linalg.lu_factor(identity - jax.jacfwd(field)(start))
        return lambda right: jax.scipy.linalg.lu_solve(whole, right)
    jacobian = sparse_jacobian(field, start, lu.entries)
    factors = lu.factorise(step_matrix(jacobian, size))
    places = list(factors)
    # As one array, whose parts are computed once and not again for each use.
    table = jnp.stack([factors[place] for place in places])

    def solve(right: Float[Array, " n"]) -> Float[Array, " n"]:
        entries = {place: table[number] for number, place in enumerate(places)}
        return jnp.stack(lu.solve(entries, [right[k] for k in range(lu.size)]))

    return solve
