"""Rounds of a match: descend, learn from the residuals what they are like, weigh anew."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..io import Experiment
from ..physics import Twin
from ..rig import CommonError
from ._camera_error import camera_shapes, detect_events
from ._levenberg_marquardt import RUNNING, BoundedLevenbergMarquardt, LMState
from ._noise import Noise, huber_weights, noise_of
from ._residuals import Problem, build_problem, differences, residual_jacobian, residuals
from ._unknowns import Unknowns
from ._weights import Weights, make_weights

FIRST_NOISE = Noise(0.25, 64.0)
"""Before anything is known of the residuals: a quarter kelvin, a minute long."""

ROUNDS = 3
LOOSE = (1e-2, 1e-3)
"""Relative fall of the cost at which rounds end that are not the last."""


Box = tuple[Float[np.ndarray, " unknowns"], Float[np.ndarray, " unknowns"]]


@final
@dataclass(frozen=True)
class Setting:
    """What a match works on.

    - `samples`: weight of each sample of each recording, 0 to 1.
    - `events`: times of the camera's corrections in each recording, s; None to look for them.
    - `common_error`: of the camera, None for none.
    - `robust`: threshold of Huber's loss in robust standard deviations, None for least squares.
    """

    twin: Twin
    experiments: tuple[Experiment, ...]
    unknowns: Unknowns
    samples: tuple[Float[np.ndarray, "times channels"], ...]
    events: tuple[tuple[float, ...], ...] | None
    common_error: CommonError | None
    robust: float | None

    @property
    def box(self) -> Box:
        """Bounds of the vector."""
        return self.unknowns.lower(), self.unknowns.upper()

    @property
    def weighs(self) -> bool:
        """Whether it matters how large the residuals are: beside priors it does."""
        priors = self.unknowns.prior_precision().any()
        return bool(priors) or self.common_error is not None or self.robust is not None


@final
@dataclass(frozen=True)
class Knowledge:
    """What is known of the residuals in a round.

    - `alone`, `common`: of what each channel has alone, and of what all share times the root of
      their number.
    - `events`: times of the camera's corrections in each recording, s.
    - `alone_weights`, `common_weights`: of each sample, by Huber's loss and the given spans.
    """

    alone: Noise
    common: Noise
    events: tuple[tuple[float, ...], ...]
    alone_weights: tuple[Float[np.ndarray, "times channels"], ...]
    common_weights: tuple[Float[np.ndarray, " times"], ...]


Step = tuple[int, float, float, bool, Float[np.ndarray, " unknowns"]]
"""Number, mean squared error (K^2), steepest cosine, whether accepted, vector."""


@final
@dataclass(frozen=True)
class Attempt:
    """Where a descent ended: the vector, the optimiser's state, all steps, and its problem."""

    vector: Float[np.ndarray, " unknowns"]
    state: LMState
    steps: tuple[Step, ...]
    problem: Problem

    @property
    def cost(self) -> float:
        """Half the sum of squared weighted residuals."""
        return float(self.state.cost)

    @property
    def mean_square(self) -> float:
        """Mean squared error of all samples, K^2."""
        return float(self.state.aux)


def estimate(
    setting: Setting,
    solver: BoundedLevenbergMarquardt,
    start: Float[np.ndarray, " unknowns"],
    max_iterations: int,
    on_step: Callable[[Step], None] | None = None,
) -> tuple[Attempt, Knowledge]:
    """Matches in rounds until the weights fit the residuals; in one where weights do not matter."""
    knowledge = first_knowledge(setting)
    rounds = ROUNDS if setting.weighs else 1
    attempt, steps = None, ()
    for number in range(rounds):
        last = number == rounds - 1
        loose = solver if last else replace(solver, rtol=LOOSE[number])
        if attempt is not None:
            # The new weights change little: go on as carefully or boldly as before.
            loose = replace(loose, damping=float(attempt.state.damping))
        problem = make_problem(setting, knowledge)
        left = max_iterations - max(0, len(steps) - 1)
        attempt = descend(problem, loose, start, left, setting.box, steps, on_step)
        steps, start = attempt.steps, attempt.vector
        if not np.isfinite(attempt.cost):
            break
        if not last:
            knowledge = learn(setting, knowledge, attempt)
    assert attempt is not None
    return attempt, knowledge


def first_knowledge(setting: Setting) -> Knowledge:
    """Before the first descent."""
    noise = FIRST_NOISE if setting.weighs else Noise(1.0, 1.0)
    return Knowledge(
        alone=noise,
        common=noise,
        events=setting.events or tuple(() for _ in setting.experiments),
        alone_weights=setting.samples,
        common_weights=tuple(np.ones(len(one)) for one in setting.samples),
    )


def make_problem(setting: Setting, knowledge: Knowledge) -> Problem:
    """The optimiser's problem with the weights that follow from what is known."""
    weights = [recording_weights(setting, knowledge, n) for n in range(len(setting.experiments))]
    return build_problem(setting.twin, setting.experiments, setting.unknowns, weights)


def recording_weights(setting: Setting, knowledge: Knowledge, number: int) -> Weights:
    """Weights of one recording."""
    time = setting.experiments[number].time
    shapes, spreads = np.zeros((len(time), 0)), np.zeros(0)
    if setting.common_error is not None:
        shapes, spreads = camera_shapes(setting.common_error, time, knowledge.events[number])
    return make_weights(
        knowledge.alone_weights[number],
        knowledge.common_weights[number],
        knowledge.alone.effective,
        knowledge.common.effective,
        shapes,
        spreads,
    )


def split_residuals(
    attempt: Attempt,
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Of each recording what channels have alone `(times, channels)`, what they share less the
    camera's error `(times,)`, and that error `(times,)`, K."""
    with jax.enable_x64(True):
        groups = _differences(jnp.asarray(attempt.vector), attempt.problem)
        found: dict[int, tuple[np.ndarray, ...]] = {}
        for group, difference in zip(attempt.problem.groups, groups, strict=True):
            alone, common, sizes = jax.vmap(lambda w, d: w.split(d))(group.weights, difference)
            error = np.einsum("rtk,rk->rt", np.asarray(group.weights.shapes), np.asarray(sizes))
            for row, position in enumerate(group.positions):
                found[position] = (np.asarray(alone[row]), np.asarray(common[row]), error[row])
    ordered = [found[position] for position in sorted(found)]
    alone, common, errors = zip(*ordered, strict=True)
    return list(alone), list(common), list(errors)


def learn(setting: Setting, knowledge: Knowledge, attempt: Attempt) -> Knowledge:
    """What the residuals of a descent tell: corrections, noise, outliers."""
    alone, common, errors = split_residuals(attempt)
    events = knowledge.events
    if setting.common_error is not None and setting.events is None:
        # What is recorded less what is simulated, with the camera's error still in it.
        events = tuple(
            detect_events(experiment.time, -(rest + error))
            for experiment, rest, error in zip(setting.experiments, common, errors, strict=True)
        )
    alone_weights = setting.samples
    common_weights = tuple(np.ones(len(one)) for one in common)
    if setting.robust is not None:
        alone_weights = tuple(
            given * huber_weights(one, setting.robust)
            for given, one in zip(setting.samples, alone, strict=True)
        )
        common_weights = tuple(huber_weights(one, setting.robust) for one in common)
    of_alone, of_common = residual_noise(alone, common, alone_weights, common_weights)
    return Knowledge(of_alone, of_common, events, alone_weights, common_weights)


def residual_noise(
    alone: Sequence[Float[np.ndarray, "times channels"]],
    common: Sequence[Float[np.ndarray, " times"]],
    alone_weights: Sequence[Float[np.ndarray, "times channels"]],
    common_weights: Sequence[Float[np.ndarray, " times"]],
) -> tuple[Noise, Noise]:
    """The noise of both parts of the residuals; where recordings have one channel, the first part
    is nothing and takes after the second."""
    parts = [one * np.sqrt(w) for one, w in zip(alone, alone_weights, strict=True)]
    # Deviations from a mean of n channels vary less than the channels do, by (n - 1) / n.
    several = [p * np.sqrt(p.shape[1] / (p.shape[1] - 1)) for p in parts if p.shape[1] > 1]
    shared = [
        (one * np.sqrt(w * v.sum(axis=1)))[:, None]
        for one, w, v in zip(common, common_weights, alone_weights, strict=True)
    ]
    of_common = noise_of(shared)
    return (noise_of(several) if several else of_common), of_common


def descend(
    problem: Problem,
    solver: BoundedLevenbergMarquardt,
    start: Float[np.ndarray, " unknowns"],
    max_iterations: int,
    box: Box,
    steps: tuple[Step, ...] = (),
    on_step: Callable[[Step], None] | None = None,
) -> Attempt:
    """Steps the optimiser from here, so that every iteration can be kept and shown.

    **Arguments:**

    - `box`: lower and upper bounds.
    - `steps`: those of earlier rounds, which these continue.
    """
    lower, upper = box
    found = list(steps)
    with jax.enable_x64(True):
        # Plain floats would be constants of the compiled step: another tolerance, another program.
        solver = eqx.tree_at(
            lambda s: [s.rtol, s.atol, s.gtol, s.damping], solver, replace_fn=jnp.asarray
        )
        bounds = (jnp.asarray(lower), jnp.asarray(upper))
        vector = jnp.asarray(start)
        mean_square = jax.ShapeDtypeStruct((), jnp.float64)
        options = {"lower": bounds[0], "upper": bounds[1]}
        state = solver.init(residuals, vector, problem, options, None, mean_square, frozenset())
        for iteration in range(max_iterations + 1):
            vector, state = _step(solver, vector, problem, bounds, state)
            if not (steps and iteration == 0):
                found.append(
                    (
                        len(found),
                        float(state.aux),
                        float(state.gradient),
                        bool(state.accepted),
                        np.asarray(vector),
                    )
                )
                if on_step is not None:
                    on_step(found[-1])
            if int(state.status) != RUNNING or not np.isfinite(float(state.cost)):
                break
    return Attempt(np.asarray(vector), state, tuple(found), problem)


@eqx.filter_jit
def _step(
    solver: BoundedLevenbergMarquardt,
    vector: Float[Array, " unknowns"],
    problem: Problem,
    bounds: tuple[Float[Array, " unknowns"], Float[Array, " unknowns"]],
    state: LMState,
) -> tuple[Float[Array, " unknowns"], LMState]:
    options = {"lower": bounds[0], "upper": bounds[1], "jacobian": residual_jacobian}
    vector, state, _ = solver.step(residuals, vector, problem, options, state, frozenset())
    return vector, state


_differences = eqx.filter_jit(differences)
