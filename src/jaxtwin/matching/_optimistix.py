"""Descents by any least-squares solver of optimistix, which supports neither bounds nor rounds."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ._descent_result import DescentResult, DescentStep, Evaluation, OnStep, Start
from ._jacobian import output_error_jacobians, residual_jacobian, weighted_jacobian
from ._objective import MatchObjective
from ._residuals import output_errors, residuals, weighted_residuals
from ._unknowns import SearchSpace

# The option of optimistix's Gauss-Newton solvers for derivatives in forward mode, which suits many
# residuals of few unknowns.
FORWARD = {"jac": "fwd"}


def descend_with(
    solver: optx.AbstractLeastSquaresSolver,
    objectives: Sequence[MatchObjective],
    starts: Sequence[Start],
    space: SearchSpace,
    max_iterations: int,
    on_step: OnStep | None,
) -> list[DescentResult]:
    """Minimises every objective by `optimistix.least_squares`, one after the other.

    Bounds are enforced by a transform of the unknowns, see `SearchSpace.to_unbounded`. optimistix
    does not report its steps; a result therefore has two, the start and the end.

    **Arguments:** those of `descend`.
    """
    results = []
    for number, (objective, start) in enumerate(zip(objectives, starts, strict=True)):
        result = _descend_once(solver, objective, start, space, max_iterations)
        results.append(result)
        if on_step is not None:
            for step in result.steps:
                on_step(number, step)
    return results


def _descend_once(
    solver: optx.AbstractLeastSquaresSolver,
    objective: MatchObjective,
    start: Start,
    space: SearchSpace,
    max_iterations: int,
) -> DescentResult:
    earlier = start if isinstance(start, DescentResult) else None
    vector = earlier.vector if earlier is not None else np.asarray(start)
    done = earlier.iterations if earlier is not None else 0
    with own_settings():
        # Plain arrays would be constants of the compiled solve.
        arrays = jax.tree.map(jnp.asarray, (objective, space))
        first = earlier.steps[0] if earlier else _step(0, _evaluate(vector, arrays[0]), vector)
        begin, left = space.to_unbounded(vector), max(1, max_iterations - done)
        # The limit is a part of the program, which all rounds share; only a round that would exceed
        # what is left of it needs a program of its own.
        solution = _solve(solver, begin, arrays, max_iterations)
        if solution.stats["num_steps"] > left:
            solution = _solve(solver, begin, arrays, left)
        end = np.asarray(arrays[1].from_unbounded(solution.value))
        result = jax.tree.map(np.asarray, _evaluate(end, arrays[0]))
        iterations = done + int(solution.stats["num_steps"])
        converged = bool(solution.result == optx.RESULTS.successful)
        words = "converged" if converged else optx.RESULTS[solution.result]
    return DescentResult(
        vector=end,
        cost=float(result.cost),
        mean_square=float(result.mean_square),
        status=f"{type(solver).__name__}: {words}",
        converged=converged,
        steps=(first, _step(iterations, result, end)),
        iterations=iterations,
        objective=objective,
        evaluation=result.evaluation,
        optimiser=None,
    )


@persistent_jit
def _solve(
    solver: optx.AbstractLeastSquaresSolver,
    start: Float[np.ndarray | Array, " unknowns"],
    arrays: tuple[MatchObjective, SearchSpace],
    max_steps: int,
) -> optx.Solution[Any, Any]:
    """One program for all rounds and starts; by itself optimistix compiles parts of each solve."""
    return optx.least_squares(
        _unbounded_residuals,
        solver,
        jnp.asarray(start),
        args=arrays,
        options=FORWARD,
        max_steps=max_steps,
        throw=False,
    )


def _unbounded_residuals(
    variables: Float[Array, " unknowns"], args: tuple[MatchObjective, SearchSpace]
) -> Float[Array, " residuals"]:
    objective, space = args
    return _residual_vector(space.from_unbounded(variables), objective)


@eqx.filter_custom_jvp
def _residual_vector(
    vector: Float[Array, " unknowns"], objective: MatchObjective
) -> Float[Array, " residuals"]:
    return ravel_pytree(residuals(vector, objective)[0])[0]


@_residual_vector.def_jvp
def _(
    primals: tuple[Array, MatchObjective], tangents: tuple[Array, object]
) -> tuple[Float[Array, " residuals"], Float[Array, " residuals"]]:
    """Uses jaxtwin's Jacobian, which skips unknowns of other recordings."""
    vector, objective = primals
    value = ravel_pytree(residuals(vector, objective)[0])[0]
    return value, residual_jacobian(vector, objective) @ tangents[0]


class _Evaluated(NamedTuple):
    """The parts of a result that belong to its vector."""

    evaluation: Evaluation
    cost: Float[np.ndarray | Array, ""]
    mean_square: Float[np.ndarray | Array, ""]
    gradient: Float[np.ndarray | Array, ""]


@persistent_jit
def _evaluate(
    vector: Float[np.ndarray | Array, " unknowns"], objective: MatchObjective
) -> _Evaluated:
    vector = jnp.asarray(vector)
    evaluation = Evaluation(
        output_errors(vector, objective), output_error_jacobians(vector, objective)
    )
    parts, mean_square = weighted_residuals(evaluation.output_errors, vector, objective)
    residual = ravel_pytree(parts)[0]
    jacobian = weighted_jacobian(evaluation.jacobians, objective)
    lengths = jnp.linalg.norm(jacobian, axis=0) * jnp.linalg.norm(residual)
    cosines = jnp.abs(jacobian.T @ residual) / jnp.where(lengths > 0, lengths, 1.0)
    return _Evaluated(
        evaluation, 0.5 * jnp.sum(residual**2), jnp.asarray(mean_square), cosines.max()
    )


def _step(
    number: int, evaluated: _Evaluated, vector: Float[np.ndarray, " unknowns"]
) -> DescentStep:
    return DescentStep(
        number, float(evaluated.mean_square), float(evaluated.gradient), True, vector
    )
