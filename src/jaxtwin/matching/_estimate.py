"""Rounds of a match: descend, learn from the residuals what they are like, weigh anew."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import jax
import numpy as np
from jaxtyping import Bool, Float

from .._errors import MatchError
from .._jax_settings import own_settings
from ..io import Experiment
from ..physics import Twin
from ..rig import CommonError
from ._camera_error import camera_shapes, count_shapes, detect_events
from ._descend import Attempt, Box, OnStep, descend
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._noise import Noise, huber_weights, noise_of
from ._residuals import Problem, Ties, build_problem
from ._unknowns import Unknowns
from ._weights import Weights, make_weights

FIRST_NOISE = Noise(0.25, 64.0)
"""Before anything is known of the residuals: a quarter kelvin, a minute long."""

ROUNDS = 3
LOOSE = (3e-2, 1e-2)
"""Relative fall of the cost at which rounds end that are not the last."""


@final
@dataclass(frozen=True, eq=False)
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
    samples: tuple[Float[np.ndarray, "_times _channels"], ...]
    events: tuple[tuple[float, ...], ...] | None
    common_error: CommonError | None
    robust: float | None

    @property
    def box(self) -> Box:
        """Bounds of the vector."""
        return self.unknowns.lower(), self.unknowns.upper()

    @property
    def scale(self) -> Float[np.ndarray, " unknowns"] | None:
        """One over how far the entries are expected to move, where priors say so."""
        precision = self.unknowns.prior_precision()
        if not precision.any():
            return None
        return np.where(precision > 0, precision, 1 / self.unknowns.widths())

    @property
    def weighs(self) -> bool:
        """Whether it matters how large the residuals are: beside priors it does."""
        priors = self.unknowns.prior_precision().any()
        return bool(priors) or self.common_error is not None or self.robust is not None


@final
@dataclass(frozen=True, eq=False)
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
    alone_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    common_weights: tuple[Float[np.ndarray, " _times"], ...]


def estimate(
    settings: Sequence[Setting],
    solver: BoundedLevenbergMarquardt,
    starts: Sequence[Float[np.ndarray, " unknowns"]],
    max_iterations: int,
    on_step: OnStep | None = None,
) -> list[tuple[Attempt, Knowledge]]:
    """Matches in rounds until the weights fit the residuals; in one where weights do not matter.

    **Arguments:**

    - `settings`: one or several, alike but for their recordings' temperatures, samples and events.
    - `solver`: with the tolerances of the last round.
    - `starts`: of each. `max_iterations`: of each, over all rounds.
    - `on_step`: called with the number of the setting and each step.

    **Raises:** `MatchError` where the recordings of two settings differ in shape.
    """
    settings = list(settings)
    knowledge = [first_knowledge(setting) for setting in settings]
    rounds = ROUNDS if settings[0].weighs else 1
    attempts: list[Attempt] = []
    for number in range(rounds):
        last = number == rounds - 1
        loose = solver if last else replace(solver, rtol=LOOSE[number])
        pairs = list(zip(settings, knowledge, strict=True))
        # Compiled steps do not follow what is found in one of the settings.
        shapes = max(shapes_needed(*pair) for pair in pairs)
        problems = [make_problem(*pair, shapes) for pair in pairs]
        if number == 0:
            _check_alike(problems)
        vectors = [one.vector for one in attempts] or starts
        attempts = descend(
            problems,
            loose,
            vectors,
            max_iterations,
            settings[0].box,
            settings[0].scale,
            attempts or None,
            on_step,
        )
        if not last:
            knowledge = [
                learn(*one) if np.isfinite(one[2].cost) else one[1]
                for one in zip(settings, knowledge, attempts, strict=True)
            ]
    return list(zip(attempts, knowledge, strict=True))


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


def _check_alike(problems: Sequence[Problem]) -> None:
    first, *others = [
        (jax.tree.structure(one), [np.shape(leaf) for leaf in jax.tree.leaves(one)])
        for one in problems
    ]
    for number, other in enumerate(others, start=1):
        if other != first:
            raise MatchError(
                f"sets: found set {number} with recordings of other shapes than set 0, allowed are "
                "equally many recordings, alike in how many channels they have and in whether the "
                "ambient temperature is recorded, and nearly alike in how many samples they have "
                "and how often their inputs change"
            )


def shapes_needed(setting: Setting, knowledge: Knowledge) -> int:
    """How many shapes the camera's common error has in the recording where it has the most.

    All have as many, so that their schedules alone say which recordings are solved at once.
    """
    error = setting.common_error
    if error is None:
        return 0
    return max(
        count_shapes(error, experiment.time, events)
        for experiment, events in zip(setting.experiments, knowledge.events, strict=True)
    )


def make_problem(
    setting: Setting, knowledge: Knowledge, shapes: int | None = None, ties: Ties | None = None
) -> Problem:
    """The optimiser's problem with the weights that follow from what is known.

    **Arguments:**

    - `shapes`: of the camera's common error; by default as many as are needed.
    - `ties`: what is known beforehand of combinations of unknowns.
    """
    count = shapes_needed(setting, knowledge) if shapes is None else shapes
    weights = [
        recording_weights(setting, knowledge, number, count)
        for number in range(len(setting.experiments))
    ]
    return build_problem(setting.twin, setting.experiments, setting.unknowns, weights, ties)


def recording_weights(setting: Setting, knowledge: Knowledge, number: int, count: int) -> Weights:
    """Weights of one recording, with that many shapes of the camera's common error."""
    time = setting.experiments[number].time
    shapes, spreads = np.zeros((len(time), 0)), np.zeros(0)
    if setting.common_error is not None:
        events = knowledge.events[number]
        shapes, spreads = camera_shapes(setting.common_error, time, events, count)
    return make_weights(
        knowledge.alone_weights[number],
        knowledge.common_weights[number],
        knowledge.alone.effective,
        knowledge.common.effective,
        shapes,
        spreads,
    )


class Residuals(NamedTuple):
    """Simulated less recorded, of each recording in parts, K.

    - `alone`: what channels have alone.
    - `common`: what they share, less the camera's error.
    - `camera`: that error.
    """

    alone: tuple[Float[np.ndarray, "_times _channels"], ...]
    common: tuple[Float[np.ndarray, " _times"], ...]
    camera: tuple[Float[np.ndarray, " _times"], ...]


def split_residuals(attempt: Attempt) -> Residuals:
    """The residuals where a descent ended."""
    found: dict[int, tuple[np.ndarray, ...]] = {}
    with own_settings():
        for group, difference in zip(attempt.problem.groups, attempt.differences, strict=True):
            alone, common, sizes = jax.vmap(lambda w, d: w.split(d))(group.weights, difference)
            error = np.einsum("rtk,rk->rt", np.asarray(group.weights.shapes), np.asarray(sizes))
            times = np.asarray(group.lengths)
            for row, position in enumerate(group.positions):
                parts = (np.asarray(alone[row]), np.asarray(common[row]), error[row])
                found[position] = tuple(part[: times[row]] for part in parts)
    ordered = [found[position] for position in sorted(found)]
    return Residuals(*zip(*ordered, strict=True))


def solved_temperatures(attempt: Attempt) -> list[Float[np.ndarray, "times channels"]]:
    """What the twin reads in each recording where a descent ended, degC."""
    found: dict[int, np.ndarray] = {}
    for group, difference in zip(attempt.problem.groups, attempt.differences, strict=True):
        for row, position in enumerate(group.positions):
            times = slice(int(group.lengths[row]))  # without the samples that fill up their number
            read = np.asarray(difference[row]) + np.asarray(group.temperatures[row])
            found[position] = read[times]
    return [found[position] for position in sorted(found)]


def learn(setting: Setting, knowledge: Knowledge, attempt: Attempt) -> Knowledge:
    """What the residuals of a descent tell: corrections, noise, outliers."""
    alone, common, errors = split_residuals(attempt)
    events = knowledge.events
    if setting.common_error is not None and setting.events is None:
        # What is recorded less what is simulated, with the camera's error still in it.
        events = tuple(
            detect_events(
                experiment.time,
                -shared_residual(one, shared, error, weight),
                np.count_nonzero(weight, axis=1) > 0,
            )
            for experiment, one, shared, error, weight in zip(
                setting.experiments, alone, common, errors, setting.samples, strict=True
            )
        )
    alone_weights = setting.samples
    common_weights = tuple(np.ones(len(one)) for one in common)
    if setting.robust is not None:
        # A single channel has nothing alone.
        alone_weights = tuple(
            given * huber_weights(one, setting.robust, beside_others(given))
            if one.shape[1] > 1
            else given
            for given, one in zip(setting.samples, alone, strict=True)
        )
        common_weights = tuple(
            huber_weights(one, setting.robust, given.sum(axis=1) > 0)
            for given, one in zip(setting.samples, common, strict=True)
        )
    noise = residual_noise(alone, common, alone_weights, common_weights)
    # Residuals that are nothing tell no noise to weigh by.
    of_alone, of_common = (
        found if found.deviation > 0 else before
        for found, before in zip(noise, (knowledge.alone, knowledge.common), strict=True)
    )
    return Knowledge(of_alone, of_common, events, alone_weights, common_weights)


def shared_residual(
    alone: Float[np.ndarray, "times channels"],
    common: Float[np.ndarray, " times"],
    camera: Float[np.ndarray, " times"],
    samples: Float[np.ndarray, "times channels"],
) -> Float[np.ndarray, " times"]:
    """The mean of the channels' residuals, with what does not count between its neighbours, K.

    Where a channel begins or ends to count, a mean of the others alone would jump.
    """
    shared = common + camera
    if (samples > 0).all():
        return shared
    whole, times = alone + shared[:, None], np.arange(len(shared))
    columns = [
        np.interp(times, times[weight > 0], column[weight > 0])
        for column, weight in zip(whole.T, samples.T, strict=True)
        if weight.any()
    ]
    return np.mean(columns, axis=0)


def beside_others(
    weights: Float[np.ndarray, "times channels"],
) -> Bool[np.ndarray, "times channels"]:
    """Which samples count beside others at the same time: one alone has nothing that is its own."""
    counted = weights > 0
    return counted & (counted.sum(axis=1, keepdims=True) > 1)


def residual_noise(
    alone: Sequence[Float[np.ndarray, "_times _channels"]],
    common: Sequence[Float[np.ndarray, " _times"]],
    alone_weights: Sequence[Float[np.ndarray, "_times _channels"]],
    common_weights: Sequence[Float[np.ndarray, " _times"]],
) -> tuple[Noise, Noise]:
    """The noise of both parts of the residuals; where no two channels count at the same time, the
    first part is nothing and takes after the second."""
    several, counted = [], 0.0
    for one, weights in zip(alone, alone_weights, strict=True):
        beside = beside_others(weights)
        if beside.any():
            # Deviations from a mean of n channels vary less than the channels do, by (n - 1) / n.
            n = np.maximum(beside.sum(axis=1, keepdims=True), 2)
            several.append(one * np.sqrt(weights * beside * n / (n - 1)))
            counted += float(np.sum(weights * beside))
    shared = [
        (one * np.sqrt(w * v.sum(axis=1)))[:, None]
        for one, w, v in zip(common, common_weights, alone_weights, strict=True)
    ]
    # Samples that do not count are no samples.
    counts = [v.sum(axis=1) > 0 for v in alone_weights]
    of_common = noise_of(shared, float(sum(one.sum() for one in counts)))
    if not several:
        return of_common, of_common
    return noise_of(several, counted), of_common
