"""Descents of jaxtwin's own optimiser, several side by side, with each step visible.

The simulation and the weighting of its residuals are compiled separately, and the derivatives are
kept with the result, so that the steps after a descent (other weights, the uncertainty) need not
compute them again.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..simulation import Modes
from ._descent_result import (
    RUNNING,
    STATUS,
    DescentResult,
    DescentStep,
    Evaluation,
    Factors,
    LMState,
    OnStep,
    Start,
)
from ._jacobian import output_error_jacobians, output_errors_and_differences
from ._levenberg_marquardt import BoundedLevenbergMarquardt, Trial
from ._native_recordings import NativeDescents
from ._objective import MatchObjective
from ._optimistix import descend_with
from ._problem import MatchProblem
from ._residuals import output_errors, recording_modes, weighted_residuals
from ._unknowns import SearchSpace

Tree = TypeVar("Tree")

# Descents that run at the same time: their derivatives need less than a hundred megabytes.
BATCH = 16


@final
class DescentState(eqx.Module):
    """The state of descents side by side: every array has a leading descents axis.

    - `vectors`: the unknowns. `evaluation`: at these vectors, None before the first evaluation.
    - `optimiser`: the state of `BoundedLevenbergMarquardt`.
    """

    vectors: Float[Array, "descents unknowns"]
    optimiser: LMState
    evaluation: Evaluation | None


def descend(
    problems: Sequence[MatchProblem],
    objectives: Sequence[MatchObjective],
    solver: optx.AbstractLeastSquaresSolver,
    starts: Sequence[Start],
    space: SearchSpace,
    max_iterations: int,
    on_step: OnStep | None = None,
) -> list[DescentResult]:
    """Minimises every objective from its start.

    **Arguments:**

    - `problems`: the problem of each objective.
    - `objectives`: objectives of equal shapes.
    - `solver`: `BoundedLevenbergMarquardt` runs all descents side by side; any other solver runs
      them one after the other through `optimistix.least_squares`.
    - `starts`: either all vectors, or all results of earlier descents with other weights.
    - `space`: bounds, scale and steps of differences, the same for all descents.
    - `max_iterations`: the limit for each descent, including the iterations of the earlier descent.
    - `on_step`: called with the number of the descent and each step.
    """
    if not isinstance(solver, BoundedLevenbergMarquardt):
        return descend_with(solver, objectives, starts, space, max_iterations, on_step)
    # The last batch is padded to the size of the others, so that it uses their compiled steps.
    size = min(len(objectives), BATCH)
    results: list[DescentResult] = []
    for first in range(0, len(objectives), BATCH):
        part = slice(first, first + BATCH)
        batch = _Batch(
            problems=_filled(problems[part], size),
            objectives=_filled(objectives[part], size),
            starts=_filled(starts[part], size),
            active=np.arange(size) < len(objectives) - first,
        )

        def report(number: int, step: DescentStep, first: int = first) -> None:
            if on_step is not None:
                on_step(first + number, step)

        results += _descend_batch(batch, solver, space, max_iterations, report)
    return results


class _Batch(NamedTuple):
    """Objectives and their starts side by side. Copies that only pad the batch are not active."""

    problems: list[MatchProblem]
    objectives: list[MatchObjective]
    starts: list[Start]
    active: Bool[np.ndarray, " descents"]


class _Proposal(NamedTuple):
    """The next vectors, one for each descent, evaluated: with Jacobians, or with the modes for
    them."""

    vectors: Float[Array, "descents unknowns"]
    output_errors: "BatchArrays"
    jacobians: "BatchArrays | None"
    modes: list[Modes] | None


def _descend_batch(
    batch: _Batch,
    solver: BoundedLevenbergMarquardt,
    space: SearchSpace,
    max_iterations: int,
    on_step: OnStep,
) -> list[DescentResult]:
    earlier = [start for start in batch.starts if isinstance(start, DescentResult)]
    steps = [list(start.steps) for start in earlier] or [[] for _ in batch.objectives]
    left = np.array([max_iterations - max(0, len(of_descent) - 1) for of_descent in steps])
    active = batch.active.copy()
    with own_settings():
        # Plain floats would be constants of the compiled step, which each new tolerance would
        # compile again.
        solver = eqx.tree_at(
            lambda s: [s.rtol, s.atol, s.gtol, s.damping], solver, replace_fn=jax.device_put
        )
        space = jax.device_put(space)
        objective = _stacked(batch.objectives)
        state = _first_state(solver, batch.starts, space)
        differences = space.difference_steps is not None
        native = None if differences else NativeDescents.of(batch.problems, objective)
        for iteration in range(int(left.max(initial=0)) + 1):
            if iteration == 0 and earlier:
                evaluation = jax.device_put(_stacked([start.evaluation for start in earlier]))
                errors, jacobians = evaluation.output_errors, evaluation.jacobians
                proposal = _Proposal(state.vectors, errors, jacobians, None)
            else:
                vectors = state.vectors
                if iteration > 0:
                    vectors = _propose(solver, vectors, state.optimiser, space)
                proposal = _proposal(vectors, objective, space, active, native, iteration)
            state = _step(solver, state, proposal, space, objective, batch, active, native)
            # Indexing NumPy arrays needs no compiled function.
            optimiser, vectors = jax.tree.map(np.asarray, (state.optimiser, state.vectors))
            for number in np.flatnonzero(active):
                if iteration > 0 or not steps[number]:
                    step = DescentStep(
                        number=len(steps[number]),
                        mean_square=float(optimiser.aux[number]),
                        gradient=float(optimiser.gradient[number]),
                        accepted=bool(optimiser.accepted[number]),
                        vector=vectors[number],
                    )
                    steps[number].append(step)
                    on_step(int(number), step)
            running = optimiser.status == RUNNING
            active &= running & np.isfinite(optimiser.cost) & (iteration < left)
            if not active.any():
                break
        ended = jax.tree.map(np.asarray, state)
    return [
        _result(jax.tree.map(lambda leaf: leaf[n], ended), batch.objectives[n], steps[n])  # noqa: B023
        for n in np.flatnonzero(batch.active)
    ]


def _first_state(
    solver: BoundedLevenbergMarquardt, starts: Sequence[Start], space: SearchSpace
) -> DescentState:
    # `jnp.asarray` would compile a copy for every shape.
    vectors = jax.device_put(
        np.stack([s.vector if isinstance(s, DescentResult) else s for s in starts])
    )
    optimiser = _first_optimiser(solver, vectors, space)
    earlier = [s.optimiser for s in starts if isinstance(s, DescentResult) and s.optimiser]
    if earlier:
        # Go on as boldly as before, but not more carefully than from a start: a descent ends with a
        # large damping where rounding stopped it, and with other weights it would stop at once.
        damping = jax.device_put(np.minimum([float(s.damping) for s in earlier], solver.damping))
        optimiser = eqx.tree_at(lambda s: s.damping, optimiser, damping)
    return DescentState(vectors, optimiser, None)


def _at_start(
    vectors: Float[Array, "descents unknowns"],
    objective: MatchObjective,
    modes: list[Modes],
) -> _Proposal:
    """Evaluates the starts, with Jacobians because a start is always accepted. If a process has
    neither of the two programs yet, both are compiled at the same time."""
    with ThreadPoolExecutor(1) as pool:
        jacobians = pool.submit(own_settings()(_differentiate), vectors, objective, modes)
        errors = _solve(vectors, objective, modes)
        return _Proposal(vectors, errors, jacobians.result(), modes)


def _step(
    solver: BoundedLevenbergMarquardt,
    state: DescentState,
    proposal: _Proposal,
    space: SearchSpace,
    objective: MatchObjective,
    batch: _Batch,
    active: Bool[np.ndarray, " descents"],
    native: NativeDescents | None,
) -> DescentState:
    """The state after a proposal. Jacobians are computed only if at least one of the trials is
    accepted."""
    vectors, errors, jacobians, modes = proposal
    costs, mean_squares = _weigh(errors, vectors, batch.objectives)
    accepted = np.asarray(_accepts(solver, state.vectors, vectors, costs, state.optimiser)) & active
    factors = state.optimiser.factors
    if accepted.any():
        if jacobians is None and native is not None:
            jacobians = native.jacobians(vectors, accepted)
        if jacobians is None:
            modes = _find_modes(vectors, objective) if modes is None else modes
            jacobians = _differentiate(vectors, objective, modes)
        factors = _factorise(errors, jacobians, vectors, batch.objectives)
    evaluation = state.evaluation
    if jacobians is not None:
        new = Evaluation(errors, jacobians)
        if evaluation is None or (len(accepted) == 1 and accepted.any()):
            evaluation = new
        elif accepted.any():
            # This is done even if all are accepted, so that the programs to compile do not depend
            # on the recordings.
            evaluation = _select(jax.device_put(accepted), new, evaluation)
    trials = Trial(vectors, costs, mean_squares, factors)
    vectors, optimiser = _update(solver, state.vectors, trials, space, state.optimiser, active)
    return DescentState(vectors, optimiser, evaluation)


def _proposal(
    vectors: "Vectors",
    objective: MatchObjective,
    space: SearchSpace,
    active: Bool[np.ndarray, " descents"],
    native: NativeDescents | None,
    iteration: int,
) -> _Proposal:
    """The next vectors, evaluated by the means that the problem has."""
    if native is not None:
        return _Proposal(vectors, native.output_errors(vectors, active), None, None)
    modes = _find_modes(vectors, objective)
    if space.difference_steps is not None:
        return _Proposal(vectors, *_solve_and_difference(vectors, objective, modes, space), modes)
    if iteration == 0:
        return _at_start(vectors, objective, modes)
    return _Proposal(vectors, _solve(vectors, objective, modes), None, modes)


def _result(
    state: DescentState, objective: MatchObjective, steps: list[DescentStep]
) -> DescentResult:
    optimiser = state.optimiser
    assert state.evaluation is not None
    return DescentResult(
        vector=np.asarray(state.vectors),
        cost=float(optimiser.cost),
        mean_square=float(optimiser.aux),
        status=STATUS[int(optimiser.status)],
        converged=int(optimiser.status) != RUNNING,
        steps=tuple(steps),
        iterations=len(steps) - 1,
        objective=objective,
        evaluation=state.evaluation,
        optimiser=optimiser,
    )


def _filled(members: Sequence[Tree], size: int) -> list[Tree]:
    """Repeats the last entry until there are `size` entries."""
    return [*members, *[members[-1]] * (size - len(members))]


def _stacked(trees: Sequence[Tree]) -> Tree:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


Vectors = Float[Array, "descents unknowns"]
Costs = Float[np.ndarray | Array, " descents"]
# One array for each batch of recordings of equal shapes, with a leading descents axis.
BatchArrays = Sequence[Float[np.ndarray | Array, "..."]]


@persistent_jit_unoptimised
def _first_optimiser(
    solver: BoundedLevenbergMarquardt, vectors: Vectors, space: SearchSpace
) -> LMState:
    aux = jax.ShapeDtypeStruct((), vectors.dtype)
    return _side_by_side(lambda vector: solver.first_state(vector, space, aux))(vectors)


@persistent_jit_unoptimised
def _propose(
    solver: BoundedLevenbergMarquardt, vectors: Vectors, optimisers: LMState, space: SearchSpace
) -> Vectors:
    return _side_by_side(lambda v, s: solver.propose(v, space, s))(vectors, optimisers)


@persistent_jit_unoptimised
def _find_modes(vectors: Vectors, objectives: MatchObjective) -> list[Modes]:
    return _side_by_side(recording_modes)(vectors, objectives)


@persistent_jit
def _solve(vectors: Vectors, objectives: MatchObjective, modes: list[Modes]) -> BatchArrays:
    return _side_by_side(output_errors)(vectors, objectives, modes)


@persistent_jit
def _differentiate(vectors: Vectors, objectives: MatchObjective, modes: list[Modes]) -> BatchArrays:
    return _side_by_side(output_error_jacobians)(vectors, objectives, modes)


@persistent_jit_unoptimised
def _solve_and_difference(
    vectors: Vectors,
    objectives: MatchObjective,
    modes: list[Modes],
    space: SearchSpace,
) -> tuple[BatchArrays, BatchArrays]:
    return _side_by_side(
        lambda vector, objective, modes: output_errors_and_differences(
            vector, space, objective, modes
        )
    )(vectors, objectives, modes)


def _weigh(
    errors: BatchArrays, vectors: Vectors, objectives: Sequence[MatchObjective]
) -> tuple[Costs, Costs]:
    """Half the sum of squared weighted residuals, and the mean squared error, K^2."""
    costs, mean_squares = [], []
    for number, objective in enumerate(objectives):
        of_descent = [np.asarray(part)[number] for part in errors]
        parts, mean_square = weighted_residuals(of_descent, np.asarray(vectors)[number], objective)
        costs.append(0.5 * sum(float(np.sum(leaf**2)) for leaf in jax.tree.leaves(parts)))
        mean_squares.append(mean_square)
    return np.array(costs), np.array(mean_squares)


def _factorise(
    errors: BatchArrays,
    jacobians: BatchArrays,
    vectors: Vectors,
    objectives: Sequence[MatchObjective],
) -> Factors:
    """The `factorise` of each descent, by LAPACK: each recording by itself, for the entries on
    which it depends, and then the triangles of all (TSQR, Demmel et al. 2012)."""
    triangles = []
    for number, objective in enumerate(objectives):
        vector, linear = np.asarray(vectors)[number], objective.linear_prior
        size, entries = len(vector), objective.layout.entry_indices()
        deviation = (vector - objective.prior_means) * objective.prior_weights
        tables = [
            np.column_stack([np.diag(objective.prior_weights), deviation]),
            np.column_stack([linear.matrix, linear.matrix @ vector - linear.values]),
        ]
        for batch, error, jacobian in zip(
            objective.same_shape_batches, errors, jacobians, strict=True
        ):
            rows = np.concatenate(
                [np.asarray(jacobian)[number], np.asarray(error)[number][:, None]], axis=1
            )
            for row, position in enumerate(batch.positions):
                weights = batch.weights_of(row)
                parts = weights.weighted(rows[row])
                columns = np.concatenate([part.reshape(len(rows[row]), -1) for part in parts], 1)
                reduced = _triangle(columns)
                table = np.zeros((len(reduced), size + 1))
                table[:, [*entries[position], size]] = reduced
                tables.append(table)
        triangles.append(_triangle(np.concatenate(tables).T))
    whole = np.stack(triangles)
    return Factors(whole[:, :-1, :-1], whole[:, :-1, -1])


def _triangle(columns: Float[np.ndarray, "columns rows"]) -> Float[np.ndarray, "columns columns"]:
    """R of the QR factorisation of a matrix, given its columns."""
    # NumPy's own takes twice as long: it copies and transposes a matrix that is tall.
    from scipy.linalg import get_lapack_funcs

    (geqrf,) = get_lapack_funcs(["geqrf"], dtype=np.float64)
    size, rows = columns.shape
    if rows < size:
        columns = np.concatenate([columns, np.zeros((size, size - rows))], axis=1)
    reduced, *_ = geqrf(columns.T, overwrite_a=True)
    return np.triu(reduced[:size])


@persistent_jit_unoptimised
def _accepts(
    solver: BoundedLevenbergMarquardt,
    vectors: Vectors,
    proposed: Vectors,
    costs: Costs,
    optimisers: LMState,
) -> Bool[Array, " descents"]:
    return _side_by_side(solver.accepts)(vectors, proposed, costs, optimisers)


@persistent_jit_unoptimised
def _update(
    solver: BoundedLevenbergMarquardt,
    vectors: Vectors,
    trials: Trial,
    space: SearchSpace,
    optimisers: LMState,
    active: Bool[np.ndarray | Array, " descents"],
) -> tuple[Vectors, LMState]:
    new = _side_by_side(lambda v, t, s: solver.update(v, t, space, s))(vectors, trials, optimisers)
    return _choose(active, new, (vectors, optimisers))


@persistent_jit
def _select(which: Bool[Array, " descents"], new: Evaluation, old: Evaluation) -> Evaluation:
    return _choose(which, new, old)


def _side_by_side(function: Callable[..., Tree]) -> Callable[..., Tree]:
    """`jax.vmap`, but a single descent is traced and compiled without the additional axis, which
    takes less time."""

    def of_descents(*batched: Any) -> Tree:
        if len(jax.tree.leaves(batched)[0]) > 1:
            return jax.vmap(function)(*batched)
        alone = function(*jax.tree.map(lambda leaf: jax.lax.squeeze(leaf, [0]), batched))
        return jax.tree.map(lambda leaf: jnp.expand_dims(leaf, 0), alone)

    return of_descents


def _choose(which: Bool[np.ndarray | Array, " descents"], new: Tree, old: Tree) -> Tree:
    def leaf(new: Array, old: Array) -> Array:
        return jnp.where(jnp.reshape(which, (-1,) + (1,) * (jnp.ndim(new) - 1)), new, old)

    return jax.tree.map(leaf, new, old)
