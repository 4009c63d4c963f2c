r"""Levenberg-Marquardt in a box, as an optimistix least-squares solver.

It has what the Levenberg-Marquardt of optimistix lacks for matching a twin: bounds, damping that
does not depend on the units of the unknowns, a stop on the gradient, and a Jacobian that is
computed only where a step was accepted.

Each step solves, over the unknowns that are not held at a bound,

$$\min_\delta \lVert J \delta + r \rVert^2 + \lambda \lVert D \delta \rVert^2$$

with $D$ the largest column norms of $J$ seen so far (Moré 1978) or as given, projects
$y + \delta$ onto the box, and accepts it where the cost falls.
An unknown is held where it is at a bound and the gradient pushes it out of the box.
$\lambda$ follows the gain ratio (Nielsen 1999).
The Jacobian enters through the triangle of its QR factorisation, so that steps do not suffer from
the square of its condition number.
"""

from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

from ._search_space import SearchSpace

Vector = Float[Array, " unknowns"]
Options = dict[str, Any]
"""Of a solve by `optimistix.least_squares`."""

RUNNING, GRADIENT, REDUCTION, STEP, STALLED = range(5)
STATUS = {
    RUNNING: "stopped at the largest number of iterations",
    GRADIENT: "the gradient is zero (within tolerance) in every direction inside the bounds",
    REDUCTION: "the cost falls no further (within tolerance)",
    STEP: "the parameters move no further (within tolerance)",
    STALLED: "no step lowers the cost any more",
}
"""What each status of a solver's state means."""


@final
class Factors(eqx.Module):
    """The QR factorisation of a Jacobian, as far as a step needs it.

    - `triangle`: R. `projected`: $Q^T r$ of the residuals.
    """

    triangle: Float[Array, "unknowns unknowns"]
    projected: Float[Array, " unknowns"]

    @property
    def gradient(self) -> Vector:
        """$J^T r$, the gradient of half the sum of squares."""
        return self.triangle.T @ self.projected


@final
class Trial(eqx.Module):
    """A vector that was tried, or those of several descents with a leading axis.

    - `vector`: the unknowns. `cost`: half the sum of squared residuals there.
    - `aux`: what the residuals came with.
    - `factors`: of the Jacobian there; not looked at where the trial is not accepted.
    """

    vector: Float[Array, "*descents unknowns"]
    cost: Float[Array, "*descents"]
    aux: PyTree[Array]
    factors: Factors


@final
class LMState(eqx.Module):
    """The state of `BoundedLevenbergMarquardt`.

    - `factors`: of the Jacobian at the last accepted vector. `cost`: half the sum of squared
      residuals there. `aux`: what these came with.
    - `scale`: D. `damping`: $\\lambda$. `growth`: its factor at the next rejection.
    - `gradient`: the largest cosine between the residuals and a column of the Jacobian that is not
      held.
    - `is_first`: whether nothing was computed yet. `accepted`: whether the last step was.
    - `status`: why to stop, see `STATUS`.
    - `num_residuals`, `num_jacobians`: how many were computed.
    """

    factors: Factors
    cost: Scalar
    scale: Float[Array, " unknowns"]
    damping: Scalar
    growth: Scalar
    gradient: Scalar
    is_first: Bool[Array, ""]
    accepted: Bool[Array, ""]
    status: Int[Array, ""]
    num_residuals: Int[Array, ""]
    num_jacobians: Int[Array, ""]
    aux: PyTree[Array]


@final
class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver[PyTree, PyTree, PyTree, LMState]):
    """Levenberg-Marquardt with bounds, for `optimistix.least_squares`.

    Bounds are options of the solve: `options={"lower": ..., "upper": ...}`, each shaped like the
    unknowns; a start outside is moved onto the box.
    Derivatives are taken in forward mode, which suits many residuals of few unknowns, unless the
    option `"jacobian"` gives a function of unknowns and arguments that returns the matrix.
    The option `"scale"` gives $D$, shaped like the unknowns: one over how far each is expected to
    move, where that is known. Directions that the residuals hardly tell are then not damped more
    than others.

    **Arguments:**

    - `rtol`: stop when an accepted step lowers the cost by less than this part of it and promised
      no more.
    - `atol`: stop when a step moves every unknown by less than this part of the length of all of
      them, each measured by its column of the Jacobian.
    - `gtol`: stop when the residual is this nearly orthogonal to every column that is not held.
    - `damping`: $\\lambda$ at the start.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    gtol: float = 1e-7
    damping: float = 1e-3
    norm: Callable[[PyTree], Scalar] = eqx.field(static=True, default=optx.max_norm)

    def init(
        self,
        fn: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
        y: PyTree,
        args: PyTree,
        options: Options,
        f_struct: PyTree,
        aux_struct: PyTree,
        tags: frozenset[object],
    ) -> LMState:
        """A state with nothing computed yet: the first step evaluates the start."""
        del fn, args, f_struct, tags
        vector, _ = ravel_pytree(y)
        return self.first_state(vector, _search_space(options, vector), aux_struct)

    def step(
        self,
        fn: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
        y: PyTree,
        args: PyTree,
        options: Options,
        state: LMState,
        tags: frozenset[object],
    ) -> tuple[PyTree, LMState, PyTree]:
        """Tries one step; computes the Jacobian where it is taken."""
        del tags
        vector, unravel = ravel_pytree(y)
        space = _search_space(options, vector)

        def residuals(vector: Vector) -> tuple[Float[Array, " residuals"], PyTree]:
            out, aux = fn(unravel(vector), args)
            return ravel_pytree(out)[0], aux

        def factorised() -> Factors:
            if "jacobian" in options:
                jacobian = options["jacobian"](unravel(proposed), args)
            else:
                jacobian = jax.jacfwd(lambda vector: residuals(vector)[0])(proposed)
            return factorise(jacobian, residual)

        proposed = self.propose(vector, space, state)
        residual, aux = residuals(proposed)
        cost = 0.5 * jnp.sum(residual**2)
        accepted = self.accepts(vector, proposed, cost, state)
        factors = jax.lax.cond(accepted, factorised, lambda: state.factors)
        trial = Trial(proposed, cost, aux, factors)
        new_vector, new_state = self.update(vector, trial, space, state)
        return unravel(new_vector), new_state, new_state.aux

    def first_state(self, vector: Vector, space: SearchSpace, aux_struct: PyTree) -> LMState:
        """The state before anything was computed.

        **Arguments:**

        - `vector`: the start. `space`: its bounds and scale.
        - `aux_struct`: shapes and types of what the residuals come with.
        """
        n, dtype = vector.size, vector.dtype
        return LMState(
            factors=Factors(jnp.zeros((n, n), dtype), jnp.zeros(n, dtype)),
            cost=jnp.array(jnp.inf, dtype),
            scale=jnp.zeros(n, dtype) if space.scale is None else jnp.asarray(space.scale, dtype),
            damping=jnp.array(self.damping, dtype),
            growth=jnp.array(2.0, dtype),
            gradient=jnp.array(jnp.inf, dtype),
            is_first=jnp.array(True),
            accepted=jnp.array(False),
            status=jnp.array(RUNNING),
            num_residuals=jnp.array(0),
            num_jacobians=jnp.array(0),
            aux=jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct),
        )

    def propose(self, vector: Vector, space: SearchSpace, state: LMState) -> Vector:
        """The vector to try next.

        `propose`, `accepts` and `update` are `step` in parts, for those who compute the residuals
        of several descents at once.
        """
        held = _held(vector, space, state.factors)
        move = _damped_step(state, held)
        return space.clip(vector + jnp.where(state.is_first, 0.0, move))

    def accepts(
        self, vector: Vector, proposed: Vector, cost: Scalar, state: LMState
    ) -> Bool[Array, ""]:
        """Whether a trial is taken, given half its sum of squared residuals."""
        predicted, _, ratio = _gain(vector, proposed, cost, state)
        return state.is_first | (jnp.isfinite(cost) & (predicted > 0) & (ratio > 1e-4))

    def update(
        self, vector: Vector, trial: Trial, space: SearchSpace, state: LMState
    ) -> tuple[Vector, LMState]:
        """The vector and the state after a trial."""
        predicted, actual, ratio = _gain(vector, trial.vector, trial.cost, state)
        accepted = self.accepts(vector, trial.vector, trial.cost, state)

        def taken(new: Array, old: Array) -> Array:
            return jnp.where(accepted, new, old)

        new_vector, new_cost = taken(trial.vector, vector), taken(trial.cost, state.cost)
        factors = jax.tree.map(taken, trial.factors, state.factors)
        lengths = jnp.linalg.norm(factors.triangle, axis=0)
        held = _held(new_vector, space, factors)
        cosine = jnp.abs(factors.gradient) / (
            jnp.maximum(lengths, _tiny(vector)) * jnp.maximum(jnp.sqrt(2 * new_cost), _tiny(vector))
        )
        steepest = jnp.max(jnp.where(held, 0.0, cosine), initial=0.0)

        # Nielsen: less damping the better the linear model was, else ever more.
        eased = state.damping * jnp.maximum(1 / 3, 1 - (2 * ratio - 1) ** 3)
        damping = taken(eased, state.damping * state.growth)
        damping = jnp.where(state.is_first, state.damping, jnp.clip(damping, 1e-12, 1e12))
        still = jnp.all(
            state.scale * jnp.abs(trial.vector - vector)
            <= self.atol * (self.atol + jnp.linalg.norm(state.scale * vector))
        )
        little = (
            accepted & (actual <= self.rtol * state.cost) & (predicted <= self.rtol * state.cost)
        )
        status = jnp.select(
            [
                accepted & ((steepest <= self.gtol) | (new_cost == 0)),
                little & ~state.is_first,
                accepted & still & ~state.is_first,
                ~accepted & (still | (state.damping >= 1e12)),
            ],
            [GRADIENT, REDUCTION, STEP, STALLED],
            RUNNING,
        )
        new_state = LMState(
            factors=factors,
            cost=new_cost,
            scale=jnp.maximum(state.scale, lengths) if space.scale is None else state.scale,
            damping=damping,
            growth=taken(jnp.full_like(state.growth, 2.0), 2 * state.growth),
            gradient=steepest,
            is_first=jnp.array(False),
            accepted=accepted,
            status=status,
            num_residuals=state.num_residuals + 1,
            num_jacobians=state.num_jacobians + accepted,
            aux=jax.tree.map(taken, trial.aux, state.aux),
        )
        return new_vector, new_state

    def terminate(
        self,
        fn: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
        y: PyTree,
        args: PyTree,
        options: Options,
        state: LMState,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Stops on any status; a start with residuals that are not finite is an error."""
        del fn, y, args, options, tags
        broken = ~state.is_first & ~jnp.isfinite(state.cost)
        result = optx.RESULTS.where(
            broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return (state.status != RUNNING) | broken, result

    def postprocess(
        self,
        fn: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
        y: PyTree,
        aux: PyTree,
        args: PyTree,
        options: Options,
        state: LMState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[PyTree, PyTree, dict[str, Array]]:
        """Hands over the status and the counts."""
        del fn, args, options, tags, result
        counts = {"num_residuals": state.num_residuals, "num_jacobians": state.num_jacobians}
        return y, aux, {"status": state.status, "cost": state.cost, **counts}


def factorise(
    jacobian: Float[Array, "residuals unknowns"], residuals: Float[Array, " residuals"]
) -> Factors:
    """The QR factorisation of a Jacobian, and the residuals in it."""
    triangle = _triangle_of(jnp.concatenate([jacobian.T, residuals[None, :]]))
    return Factors(triangle[:-1, :-1], triangle[:-1, -1])


def _held(vector: Vector, space: SearchSpace, factors: Factors) -> Bool[Array, " unknowns"]:
    """Which unknowns are at a bound with a gradient that pushes them out."""
    below = (vector <= space.lower) & (factors.gradient > 0)
    return below | ((vector >= space.upper) & (factors.gradient < 0))


def _gain(
    vector: Vector, proposed: Vector, cost: Scalar, state: LMState
) -> tuple[Scalar, Scalar, Scalar]:
    """By how much a step should lower the cost, by how much it does, and their ratio."""
    linear = state.factors.triangle @ (proposed - vector)
    predicted = -(jnp.sum(linear * state.factors.projected) + 0.5 * jnp.sum(linear**2))
    actual = state.cost - cost
    return predicted, actual, actual / jnp.where(predicted > 0, predicted, jnp.inf)


def _triangle_of(columns: Float[Array, "columns rows"]) -> Float[Array, "columns columns"]:
    """R of the QR factorisation of a tall matrix, given its columns, by Cholesky factors of their
    products, three times, the first shifted (Fukaya et al. 2020).

    As exact as Householder's, which XLA does forty times more slowly on a CPU (jax 0.10.2, eighteen
    thousand rows), and at home on an accelerator.
    """
    n = columns.shape[0]
    identity = jnp.eye(n, dtype=columns.dtype)
    shift = 100 * n * jnp.finfo(columns.dtype).eps * identity
    lower, q = identity, columns
    for _ in range(3):
        products = q @ q.T
        lengths = jnp.sqrt(jnp.diag(products))
        divisors = jnp.where(lengths > 0, lengths, 1.0)
        # Columns that depend on others leave nothing behind: the shift keeps the factor defined.
        factor = jnp.linalg.cholesky(products / jnp.outer(divisors, divisors) + shift)
        lower = lower @ (lengths[:, None] * factor)
        q = (jax.scipy.linalg.solve_triangular(factor, identity, lower=True) / divisors) @ q
    return lower.T


def _damped_step(state: LMState, held: Bool[Array, " unknowns"]) -> Vector:
    n = state.factors.projected.size
    # A column of zeros has no scale of its own; any will do, as nothing moves along it.
    scale = jnp.where(state.scale > 0, state.scale, 1.0)
    triangle = jnp.where(held[None, :], 0.0, state.factors.triangle)
    damped = jnp.concatenate([triangle, jnp.diag(jnp.sqrt(state.damping) * scale)])
    q, r = jnp.linalg.qr(damped)
    move = jax.scipy.linalg.solve_triangular(r, -q[:n].T @ state.factors.projected)
    return jnp.where(held, 0.0, move)


def _search_space(options: Options, vector: Vector) -> SearchSpace:
    def option(name: str, default: float) -> Vector:
        value = options.get(name)
        return jnp.full_like(vector, default) if value is None else ravel_pytree(value)[0]

    scale = options.get("scale")
    return SearchSpace(
        lower=option("lower", -jnp.inf),
        upper=option("upper", jnp.inf),
        scale=None if scale is None else ravel_pytree(scale)[0],
    )


def _tiny(like: Array) -> float:
    return float(jnp.finfo(like.dtype).tiny) ** 0.5
