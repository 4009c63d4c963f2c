r"""Levenberg-Marquardt in a box, as an optimistix least-squares solver.

What optimistix's own solver lacks for matching a twin: bounds, damping that does not depend on the
units of the parameters, a stop on the gradient, and a Jacobian only where a step was accepted.

Each step solves, over the parameters that are not held at a bound,

$$\min_\delta \lVert J \delta + r \rVert^2 + \lambda \lVert D \delta \rVert^2$$

with $D$ the largest column norms of $J$ seen so far (Moré 1978) or as given, projects
$y + \delta$ onto the box, and accepts it where the cost falls.
A parameter is held where it is at a bound and the gradient pushes it out of the box.
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

Bounds = tuple[Float[Array, " parameters"], Float[Array, " parameters"]]

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
class LMState(eqx.Module):
    """State of `BoundedLevenbergMarquardt`.

    - `triangle`, `projected`: R and $Q^T r$ of the Jacobian's QR factorisation.
    - `cost`: half the sum of squared residuals.
    - `scale`: D. `damping`: $\\lambda$. `growth`: its factor at the next rejection.
    - `gradient`: the largest cosine between the residual and a column of the Jacobian that is not
      held.
    - `accepted`: whether the last step was. `status`: why to stop, see `STATUS`.
    - `residuals`, `jacobians`: how many were computed.
    """

    triangle: Float[Array, "parameters parameters"]
    projected: Float[Array, " parameters"]
    cost: Scalar
    scale: Float[Array, " parameters"]
    damping: Scalar
    growth: Scalar
    gradient: Scalar
    first: Bool[Array, ""]
    accepted: Bool[Array, ""]
    status: Int[Array, ""]
    residuals: Int[Array, ""]
    jacobians: Int[Array, ""]
    aux: Any


@final
class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver[Any, Any, Any, LMState]):
    """Levenberg-Marquardt with bounds, for `optimistix.least_squares`.

    Bounds are options of the solve: `options={"lower": ..., "upper": ...}`, each shaped like the
    parameters; a start outside is moved onto the box.
    Derivatives are taken in forward mode, which suits many residuals of few parameters, unless the
    option `"jacobian"` gives a function of parameters and arguments that returns the matrix.
    The option `"scale"` gives $D$, shaped like the parameters: one over how far each is expected to
    move, where that is known. Directions that the residuals hardly tell are then not damped more
    than others.

    **Arguments:**

    - `rtol`: stop when an accepted step lowers the cost by less than this part of it and promised
      no more.
    - `atol`: stop when a step moves every parameter by less than this part of the length of all of
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
        fn: Callable[[Any, Any], tuple[Any, Any]],
        y: Any,
        args: Any,
        options: dict[str, Any],
        f_struct: Any,
        aux_struct: Any,
        tags: frozenset[object],
    ) -> LMState:
        """A state with nothing computed yet: the first step evaluates the start."""
        del fn, args, f_struct, tags
        flat, _ = ravel_pytree(y)
        scale = _scale(options)
        n, dtype = flat.size, flat.dtype
        return LMState(
            triangle=jnp.zeros((n, n), dtype),
            projected=jnp.zeros(n, dtype),
            cost=jnp.array(jnp.inf, dtype),
            scale=jnp.zeros(n, dtype) if scale is None else scale,
            damping=jnp.array(self.damping, dtype),
            growth=jnp.array(2.0, dtype),
            gradient=jnp.array(jnp.inf, dtype),
            first=jnp.array(True),
            accepted=jnp.array(False),
            status=jnp.array(RUNNING),
            residuals=jnp.array(0),
            jacobians=jnp.array(0),
            aux=jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct),
        )

    def step(
        self,
        fn: Callable[[Any, Any], tuple[Any, Any]],
        y: Any,
        args: Any,
        options: dict[str, Any],
        state: LMState,
        tags: frozenset[object],
    ) -> tuple[Any, LMState, Any]:
        """Tries one step; computes the Jacobian where it is taken."""
        del tags
        flat, unravel = ravel_pytree(y)
        bounds = _bounds(options, flat)

        def residuals(flat: Array) -> tuple[Array, Any]:
            out, aux = fn(unravel(flat), args)
            return ravel_pytree(out)[0], aux

        trial = self.propose(flat, bounds, state)
        residual, aux = residuals(trial)
        cost = 0.5 * jnp.sum(residual**2)

        def factorised() -> tuple[Array, Array]:
            if "jacobian" in options:
                jacobian = options["jacobian"](unravel(trial), args)
            else:
                jacobian = jax.jacfwd(lambda flat: residuals(flat)[0])(trial)
            return factors(jacobian, residual)

        parts = jax.lax.cond(
            self.accepts(flat, trial, cost, state),
            factorised,
            lambda: (state.triangle, state.projected),
        )
        new_flat, new_state = self.judge(
            flat, trial, cost, aux, parts, bounds, state, _scale(options)
        )
        return unravel(new_flat), new_state, new_state.aux

    def propose(
        self, flat: Float[Array, " parameters"], bounds: Bounds, state: LMState
    ) -> Float[Array, " parameters"]:
        """Where to try next: `step` in parts, for those who compute the residuals elsewhere.

        **Arguments:**

        - `flat`: the parameters as a vector.
        - `bounds`: lower and upper.
        - `state`: as it was there.
        """
        lower, upper = bounds
        gradient = state.triangle.T @ state.projected
        held = ((flat <= lower) & (gradient > 0)) | ((flat >= upper) & (gradient < 0))
        move = _damped_step(state, held)
        return jnp.clip(flat + jnp.where(state.first, 0.0, move), lower, upper)

    def accepts(
        self,
        flat: Float[Array, " parameters"],
        trial: Float[Array, " parameters"],
        cost: Scalar,
        state: LMState,
    ) -> Bool[Array, ""]:
        """Whether a trial is taken, given half its sum of squared residuals."""
        predicted, _, ratio = _gain(flat, trial, cost, state)
        return state.first | (jnp.isfinite(cost) & (predicted > 0) & (ratio > 1e-4))

    def judge(
        self,
        flat: Float[Array, " parameters"],
        trial: Float[Array, " parameters"],
        cost: Scalar,
        aux: Any,
        parts: tuple[Float[Array, "parameters parameters"], Float[Array, " parameters"]],
        bounds: Bounds,
        state: LMState,
        scale: Float[Array, " parameters"] | None = None,
    ) -> tuple[Float[Array, " parameters"], LMState]:
        """The parameters and the state after a trial.

        **Arguments:**

        - `flat`, `trial`, `cost`, `bounds`, `state`: as above.
        - `aux`: what the residuals came with.
        - `parts`: `factors` of the Jacobian at the trial; not looked at where it is not accepted.
        - `scale`: D, None for the largest column norms so far.
        """
        lower, upper = bounds
        predicted, actual, ratio = _gain(flat, trial, cost, state)
        accepted = self.accepts(flat, trial, cost, state)
        move = trial - flat
        triangle = jnp.where(accepted, parts[0], state.triangle)
        projected = jnp.where(accepted, parts[1], state.projected)
        lengths = jnp.linalg.norm(triangle, axis=0)
        new_cost = jnp.where(accepted, cost, state.cost)
        new_flat = jnp.where(accepted, trial, flat)
        gradient = triangle.T @ projected
        held = ((new_flat <= lower) & (gradient > 0)) | ((new_flat >= upper) & (gradient < 0))
        cosine = jnp.abs(gradient) / (
            jnp.maximum(lengths, _tiny(flat)) * jnp.maximum(jnp.sqrt(2 * new_cost), _tiny(flat))
        )
        steepest = jnp.max(jnp.where(held, 0.0, cosine), initial=0.0)

        # Nielsen: less damping the better the linear model was, else ever more.
        eased = state.damping * jnp.maximum(1 / 3, 1 - (2 * ratio - 1) ** 3)
        damping = jnp.where(accepted, eased, state.damping * state.growth)
        damping = jnp.where(state.first, state.damping, jnp.clip(damping, 1e-12, 1e12))
        still = jnp.all(
            state.scale * jnp.abs(move)
            <= self.atol * (self.atol + jnp.linalg.norm(state.scale * flat))
        )
        little = (
            accepted & (actual <= self.rtol * state.cost) & (predicted <= self.rtol * state.cost)
        )
        status = jnp.select(
            [
                accepted & ((steepest <= self.gtol) | (new_cost == 0)),
                little & ~state.first,
                accepted & still & ~state.first,
                ~accepted & (still | (state.damping >= 1e12)),
            ],
            [GRADIENT, REDUCTION, STEP, STALLED],
            RUNNING,
        )
        new_state = LMState(
            triangle=triangle,
            projected=projected,
            cost=new_cost,
            scale=jnp.maximum(state.scale, lengths) if scale is None else scale,
            damping=damping,
            growth=jnp.where(accepted, 2.0, 2 * state.growth).astype(flat.dtype),
            gradient=steepest,
            first=jnp.array(False),
            accepted=accepted,
            status=status,
            residuals=state.residuals + 1,
            jacobians=state.jacobians + accepted,
            aux=jax.tree.map(lambda new, old: jnp.where(accepted, new, old), aux, state.aux),
        )
        return new_flat, new_state

    def terminate(
        self,
        fn: Callable[[Any, Any], tuple[Any, Any]],
        y: Any,
        args: Any,
        options: dict[str, Any],
        state: LMState,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Stops on any status; a start with residuals that are not finite is an error."""
        del fn, y, args, options, tags
        broken = ~state.first & ~jnp.isfinite(state.cost)
        result = optx.RESULTS.where(
            broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return (state.status != RUNNING) | broken, result

    def postprocess(
        self,
        fn: Callable[[Any, Any], tuple[Any, Any]],
        y: Any,
        aux: Any,
        args: Any,
        options: dict[str, Any],
        state: LMState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Any, Any, dict[str, Any]]:
        """Hands over the status and the counts."""
        del fn, args, options, tags, result
        counts = {"num_residuals": state.residuals, "num_jacobians": state.jacobians}
        return y, aux, {"status": state.status, "cost": state.cost, **counts}


def factors(
    jacobian: Float[Array, "residuals parameters"], residual: Float[Array, " residuals"]
) -> tuple[Float[Array, "parameters parameters"], Float[Array, " parameters"]]:
    """R and $Q^T r$ of the Jacobian's QR factorisation."""
    triangle = _triangle_of(jnp.concatenate([jacobian.T, residual[None, :]]))
    return triangle[:-1, :-1], triangle[:-1, -1]


def _gain(flat: Array, trial: Array, cost: Scalar, state: LMState) -> tuple[Array, Array, Array]:
    """By how much a step should lower the cost, by how much it does, and their ratio."""
    linear = state.triangle @ (trial - flat)
    predicted = -(jnp.sum(linear * state.projected) + 0.5 * jnp.sum(linear**2))
    actual = state.cost - cost
    return predicted, actual, actual / jnp.where(predicted > 0, predicted, jnp.inf)


def _triangle_of(columns: Float[Array, "columns rows"]) -> Float[Array, "columns columns"]:
    """R of the QR factorisation of a tall matrix, given its columns, by Cholesky factors of their
    products, three times, the first shifted (Fukaya et al. 2020).

    As exact as Householder's, which XLA does forty times more slowly on a CPU (jax 0.10.2, eighteen
    thousand rows), and at home on an accelerator.
    """
    n = columns.shape[0]
    one = jnp.eye(n, dtype=columns.dtype)
    shift = 100 * n * jnp.finfo(columns.dtype).eps * one
    lower, q = one, columns
    for _ in range(3):
        products = q @ q.T
        lengths = jnp.sqrt(jnp.diag(products))
        divisors = jnp.where(lengths > 0, lengths, 1.0)
        # Columns that depend on others leave nothing behind: the shift keeps the factor defined.
        factor = jnp.linalg.cholesky(products / jnp.outer(divisors, divisors) + shift)
        lower = lower @ (lengths[:, None] * factor)
        q = (jax.scipy.linalg.solve_triangular(factor, one, lower=True) / divisors) @ q
    return lower.T


def _damped_step(state: LMState, held: Bool[Array, " parameters"]) -> Float[Array, " parameters"]:
    n = state.projected.size
    # A column of zeros has no scale of its own; any will do, as nothing moves along it.
    scale = jnp.where(state.scale > 0, state.scale, 1.0)
    triangle = jnp.where(held[None, :], 0.0, state.triangle)
    damped = jnp.concatenate([triangle, jnp.diag(jnp.sqrt(state.damping) * scale)])
    q, r = jnp.linalg.qr(damped)
    move = jax.scipy.linalg.solve_triangular(r, -q[:n].T @ state.projected)
    return jnp.where(held, 0.0, move)


def _bounds(options: dict[str, Any], flat: Array) -> tuple[Array, Array]:
    def bound(name: str, default: float) -> Array:
        value = options.get(name)
        return jnp.full_like(flat, default) if value is None else ravel_pytree(value)[0]

    return bound("lower", -jnp.inf), bound("upper", jnp.inf)


def _scale(options: dict[str, Any]) -> Float[Array, " parameters"] | None:
    given = options.get("scale")
    return None if given is None else ravel_pytree(given)[0]


def _tiny(like: Array) -> float:
    return float(jnp.finfo(like.dtype).tiny) ** 0.5
