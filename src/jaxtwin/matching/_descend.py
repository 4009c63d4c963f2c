"""Descents of the optimiser, several at once, step by step so that each can be kept and shown.

The simulation's part of a step is compiled apart from the weights', and its derivatives are kept
with the result: what follows a descent (other weights, uncertainty) computes nothing again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._jax_settings import own_settings
from ._levenberg_marquardt import RUNNING, BoundedLevenbergMarquardt, LMState, factors
from ._residuals import Objective, derivatives, differences, weighted, weighted_jacobian

Box = tuple[Float[np.ndarray, " unknowns"], Float[np.ndarray, " unknowns"]]
"""Lower and upper bounds of the vector."""

Step = tuple[int, float, float, bool, Float[np.ndarray, " unknowns"]]
"""Number, mean squared error (K^2), steepest cosine, whether accepted, vector."""

OnStep = Callable[[int, Step], None]
"""Called with the number of the descent and its step."""

CHUNK = 16
"""Descents at a time: what their derivatives take stays below a hundred megabytes."""


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """Where a descent ended.

    - `vector`, `state`: of the optimiser. `steps`: all of them, earlier rounds' too.
    - `objective`: what it worked on.
    - `differences`, `derivatives`: of the problem at the vector, see `_residuals`.
    """

    vector: Float[np.ndarray, " unknowns"]
    state: LMState
    steps: tuple[Step, ...]
    objective: Objective
    differences: list[Any]
    derivatives: list[Any]

    @property
    def cost(self) -> float:
        """Half the sum of squared weighted residuals."""
        return float(self.state.cost)

    @property
    def mean_square(self) -> float:
        """Mean squared error of all samples, K^2."""
        return float(self.state.aux)

    def jacobian(self) -> Float[np.ndarray, "residuals unknowns"]:
        """Of the weighted residuals."""
        with own_settings():
            return np.asarray(_jacobian(self.derivatives, self.objective))


def descend(
    objectives: Sequence[Objective],
    solver: BoundedLevenbergMarquardt,
    starts: Sequence[Float[np.ndarray, " unknowns"]],
    max_iterations: int,
    box: Box,
    scale: Float[np.ndarray, " unknowns"] | None = None,
    before: Sequence[DescentResult] | None = None,
    on_step: OnStep | None = None,
) -> list[DescentResult]:
    """Descends in every problem from its start.

    **Arguments:**

    - `objectives`: of equal shapes.
    - `box`: of all.
    - `scale`: option of the solver.
    - `before`: earlier rounds, which these continue where they ended, or None.
    """
    # The last chunk is filled up, so that the others' compiled steps are its own.
    size = min(len(objectives), CHUNK)
    found = []
    for first in range(0, len(objectives), CHUNK):
        part = slice(first, first + CHUNK)

        def report_step(number: int, step: Step, first: int = first) -> None:
            if on_step is not None:
                on_step(first + number, step)

        found += _descend_chunk(
            objectives[part],
            solver,
            starts[part],
            max_iterations,
            box,
            scale,
            None if before is None else before[part],
            report_step,
            size,
        )
    return found


def _descend_chunk(
    objectives: Sequence[Objective],
    solver: BoundedLevenbergMarquardt,
    starts: Sequence[Float[np.ndarray, " unknowns"]],
    max_iterations: int,
    box: Box,
    scale: Float[np.ndarray, " unknowns"] | None,
    before: Sequence[DescentResult] | None,
    on_step: OnStep,
    size: int,
) -> list[DescentResult]:
    count = len(objectives)
    objectives, starts = _filled(objectives, size), _filled(starts, size)
    before = None if before is None else _filled(before, size)
    with own_settings():
        # Plain floats would be constants of the compiled step: another tolerance, another program.
        solver = eqx.tree_at(
            lambda s: [s.rtol, s.atol, s.gtol, s.damping], solver, replace_fn=jnp.asarray
        )
        bounds = (jnp.asarray(box[0]), jnp.asarray(box[1]))
        objective = jax.tree.map(lambda *leaves: np.stack(leaves), *objectives)
        vectors = jnp.asarray(np.stack(starts))
        widths = None if scale is None else jnp.asarray(scale)
        state = _start(solver, vectors, widths)
        known: Any = None
        if before is not None:
            # The new weights change little: go on as carefully or boldly as before.
            damping = np.array([float(one.state.damping) for one in before])
            state = eqx.tree_at(lambda s: s.damping, state, jnp.asarray(damping))
            known = jax.tree.map(
                lambda *leaves: np.stack(leaves),
                *((one.differences, one.derivatives) for one in before),
            )
        steps = [[] for _ in objectives] if before is None else [list(one.steps) for one in before]
        left = np.array([max_iterations - max(0, len(one) - 1) for one in steps])
        active = np.arange(size) < count
        for iteration in range(int(left.max(initial=0)) + 1):
            if iteration == 0 and known is not None:
                trials, (new, slopes) = vectors, known
            else:
                trials = _propose(solver, vectors, bounds, state)
                new, slopes = _differences(trials, objective), None
            residual, cost, mean_square = _weigh(new, trials, objective)
            accepted = np.asarray(_accepts(solver, vectors, trials, cost, state)) & active
            if slopes is None and accepted.any():
                slopes = _derivatives(trials, objective)
            if slopes is None or not accepted.any():
                parts = (state.triangle, state.projected)
            else:
                parts = _factors(slopes, residual, objective)
            if known is None:
                known = (new, slopes)
            elif accepted.any():
                known = _chosen(jnp.asarray(accepted), (new, slopes), known)
            vectors, state = _judge(
                solver, vectors, trials, cost, mean_square, parts, bounds, state, active, widths
            )
            status, costs = np.asarray(state.status), np.asarray(state.cost)
            for number in np.flatnonzero(active):
                if iteration > 0 or not steps[number]:
                    step = (
                        len(steps[number]),
                        float(state.aux[number]),
                        float(state.gradient[number]),
                        bool(state.accepted[number]),
                        np.asarray(vectors[number]),
                    )
                    steps[number].append(step)
                    on_step(int(number), step)
            active &= (status == RUNNING) & np.isfinite(costs) & (iteration < left)
            if not active.any():
                break
        ended = jax.tree.map(np.asarray, (vectors, state, known))
    return [
        DescentResult(
            vector=ended[0][number],
            state=_of(ended[1], number),
            steps=tuple(steps[number]),
            objective=objectives[number],
            differences=_of(ended[2][0], number),
            derivatives=_of(ended[2][1], number),
        )
        for number in range(count)
    ]


def _filled(some: Sequence[Any], size: int) -> list[Any]:
    """Repeats the last one."""
    return [*some, *[some[-1]] * (size - len(some))]


def _of(tree: Any, number: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[number], tree)


@eqx.filter_jit
def _start(
    solver: BoundedLevenbergMarquardt, vectors: Float[Array, "descents unknowns"], scale: Any
) -> LMState:
    aux = jax.ShapeDtypeStruct((), vectors.dtype)

    def one(vector: Array) -> LMState:
        return solver.init(_nothing, vector, None, {"scale": scale}, None, aux, frozenset())

    return jax.vmap(one)(vectors)


def _nothing(vector: Any, args: Any) -> tuple[Any, Any]:
    return vector, args


@eqx.filter_jit
def _propose(solver: Any, vectors: Any, bounds: Any, states: Any) -> Any:
    return jax.vmap(lambda v, s: solver.propose(v, bounds, s))(vectors, states)


@eqx.filter_jit
def _differences(vectors: Any, objectives: Any) -> Any:
    return jax.vmap(differences)(vectors, objectives)


@eqx.filter_jit
def _derivatives(vectors: Any, objectives: Any) -> Any:
    return jax.vmap(derivatives)(vectors, objectives)


@eqx.filter_jit
def _weigh(groups: Any, vectors: Any, objectives: Any) -> Any:
    def one(groups: Any, vector: Any, objective: Any) -> Any:
        parts, mean_square = weighted(groups, vector, objective)
        residual = ravel_pytree(parts)[0]
        return residual, 0.5 * jnp.sum(residual**2), mean_square

    return jax.vmap(one)(groups, vectors, objectives)


@eqx.filter_jit
def _factors(groups: Any, residuals: Any, objectives: Any) -> Any:
    return jax.vmap(lambda g, r, p: factors(weighted_jacobian(g, p), r))(
        groups, residuals, objectives
    )


@eqx.filter_jit
def _accepts(solver: Any, vectors: Any, trials: Any, costs: Any, states: Any) -> Any:
    return jax.vmap(solver.accepts)(vectors, trials, costs, states)


@eqx.filter_jit
def _judge(
    solver: Any,
    vectors: Any,
    trials: Any,
    costs: Any,
    mean_squares: Any,
    parts: Any,
    bounds: Any,
    states: Any,
    active: Any,
    scale: Any,
) -> Any:
    new = jax.vmap(lambda v, t, c, a, p, s: solver.judge(v, t, c, a, p, bounds, s, scale))(
        vectors, trials, costs, mean_squares, parts, states
    )
    return _choose(active, new, (vectors, states))


@eqx.filter_jit
def _chosen(accepted: Any, new: Any, old: Any) -> Any:
    return _choose(accepted, new, old)


def _choose(which: Any, new: Any, old: Any) -> Any:
    def one(new: Any, old: Any) -> Any:
        return jnp.where(jnp.reshape(which, (-1,) + (1,) * (jnp.ndim(new) - 1)), new, old)

    return jax.tree.map(one, new, old)


_jacobian = eqx.filter_jit(weighted_jacobian)
