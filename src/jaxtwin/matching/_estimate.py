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
from ._descend import Box, DescentResult, OnStep, descend
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._noise import Noise, estimate_noise, huber_weights
from ._residuals import Objective, Ties, build_objective
from ._unknowns import Unknowns
from ._weights import Weights, make_weights

FIRST_NOISE = Noise(0.25, 64.0)
"""Before anything is known of the residuals: a quarter kelvin, a minute long."""

ROUNDS = 3
LOOSE = (3e-2, 1e-2)
"""Relative fall of the cost at which rounds end that are not the last."""


@final
@dataclass(frozen=True, eq=False)
class MatchProblem:
    """What a match works on.

    - `sample_weights`: weight of each sample of each recording, 0 to 1.
    - `events`: times of the camera's corrections in each recording, s; None to look for them.
    - `common_error`: of the camera, None for none.
    - `robust`: threshold of Huber's loss in robust standard deviations, None for least squares.
    """

    twin: Twin
    experiments: tuple[Experiment, ...]
    unknowns: Unknowns
    sample_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    events: tuple[tuple[float, ...], ...] | None
    common_error: CommonError | None
    robust: float | None

    @property
    def bounds(self) -> Box:
        """Bounds of the vector."""
        return self.unknowns.lower(), self.unknowns.upper()

    @property
    def scale(self) -> Float[np.ndarray, " unknowns"] | None:
        """One over how far the entries are expected to move, where priors say so."""
        precision = self.unknowns.prior_weights()
        if not precision.any():
            return None
        return np.where(precision > 0, precision, 1 / self.unknowns.default_scales())

    @property
    def is_weighted(self) -> bool:
        """Whether it matters how large the residuals are: beside priors it does."""
        priors = self.unknowns.prior_weights().any()
        return bool(priors) or self.common_error is not None or self.robust is not None


@final
@dataclass(frozen=True, eq=False)
class NoiseModel:
    """What a match assumes of its residuals' noise, and what follows: weights of all samples.

    The residuals of a recording are split into their common mode, the mean over the channels, and
    what is left in each channel.

    - `channel`: the noise of what is left in each channel.
    - `common_mode`: the noise of the common mode times the root of the number of channels.
    - `events`: times of the camera's corrections in each recording, s.
    - `channel_weights`, `common_mode_weights`: weights of the samples, 0 to 1, from masks and from
      Huber's loss.
    """

    channel: Noise
    common_mode: Noise
    events: tuple[tuple[float, ...], ...]
    channel_weights: tuple[Float[np.ndarray, "_times _channels"], ...]
    common_mode_weights: tuple[Float[np.ndarray, " _times"], ...]


def estimate(
    problems: Sequence[MatchProblem],
    solver: BoundedLevenbergMarquardt,
    starts: Sequence[Float[np.ndarray, " unknowns"]],
    max_iterations: int,
    on_step: OnStep | None = None,
) -> list[tuple[DescentResult, NoiseModel]]:
    """Matches in rounds until the weights fit the residuals; in one where weights do not matter.

    **Arguments:**

    - `problems`: one or several, alike but for their recordings' temperatures, samples and events.
    - `solver`: with the tolerances of the last round.
    - `starts`: of each. `max_iterations`: of each, over all rounds.
    - `on_step`: called with the number of the problem and each step.

    **Raises:** `MatchError` where the recordings of two problems differ in shape.
    """
    problems = list(problems)
    noise_model = [initial_noise_model(problem) for problem in problems]
    rounds = ROUNDS if problems[0].is_weighted else 1
    results: list[DescentResult] = []
    for number in range(rounds):
        last = number == rounds - 1
        loose = solver if last else replace(solver, rtol=LOOSE[number])
        pairs = list(zip(problems, noise_model, strict=True))
        # Compiled steps do not follow what is found in one of the problems.
        shapes = max(shapes_needed(*pair) for pair in pairs)
        objectives = [make_objective(*pair, shapes) for pair in pairs]
        if number == 0:
            _check_alike(objectives)
        vectors = [one.vector for one in results] or starts
        results = descend(
            objectives,
            loose,
            vectors,
            max_iterations,
            problems[0].bounds,
            problems[0].scale,
            results or None,
            on_step,
        )
        if not last:
            noise_model = [
                update_noise_model(*one) if np.isfinite(one[2].cost) else one[1]
                for one in zip(problems, noise_model, results, strict=True)
            ]
    return list(zip(results, noise_model, strict=True))


def initial_noise_model(problem: MatchProblem) -> NoiseModel:
    """Before the first descent."""
    noise = FIRST_NOISE if problem.is_weighted else Noise(1.0, 1.0)
    return NoiseModel(
        channel=noise,
        common_mode=noise,
        events=problem.events or tuple(() for _ in problem.experiments),
        channel_weights=problem.sample_weights,
        common_mode_weights=tuple(np.ones(len(one)) for one in problem.sample_weights),
    )


def _check_alike(objectives: Sequence[Objective]) -> None:
    first, *others = [
        (jax.tree.structure(one), [np.shape(leaf) for leaf in jax.tree.leaves(one)])
        for one in objectives
    ]
    for number, other in enumerate(others, start=1):
        if other != first:
            raise MatchError(
                f"sets: found set {number} with recordings of other shapes than set 0, allowed are "
                "equally many recordings, alike in how many channels they have and in whether the "
                "ambient temperature is recorded, and nearly alike in how many samples they have "
                "and how often their inputs change"
            )


def shapes_needed(problem: MatchProblem, noise_model: NoiseModel) -> int:
    """How many shapes the camera's common error has in the recording where it has the most.

    All have as many, so that their schedules alone say which recordings are solved at once.
    """
    error = problem.common_error
    if error is None:
        return 0
    return max(
        count_shapes(error, experiment.time, events)
        for experiment, events in zip(problem.experiments, noise_model.events, strict=True)
    )


def make_objective(
    problem: MatchProblem,
    noise_model: NoiseModel,
    shapes: int | None = None,
    ties: Ties | None = None,
) -> Objective:
    """The optimiser's problem with the weights that follow from what is known.

    **Arguments:**

    - `shapes`: of the camera's common error; by default as many as are needed.
    - `ties`: what is known beforehand of combinations of unknowns.
    """
    count = shapes_needed(problem, noise_model) if shapes is None else shapes
    weights = [
        recording_weights(problem, noise_model, number, count)
        for number in range(len(problem.experiments))
    ]
    return build_objective(problem.twin, problem.experiments, problem.unknowns, weights, ties)


def recording_weights(
    problem: MatchProblem, noise_model: NoiseModel, number: int, count: int
) -> Weights:
    """Weights of one recording, with that many shapes of the camera's common error."""
    time = problem.experiments[number].time
    shapes, spreads = np.zeros((len(time), 0)), np.zeros(0)
    if problem.common_error is not None:
        events = noise_model.events[number]
        shapes, spreads = camera_shapes(problem.common_error, time, events, count)
    return make_weights(
        noise_model.channel_weights[number],
        noise_model.common_mode_weights[number],
        noise_model.channel.effective,
        noise_model.common_mode.effective,
        shapes,
        spreads,
    )


class Residuals(NamedTuple):
    """Simulated less recorded, of each recording in parts, K.

    - `channel`: what channels have alone.
    - `common_mode`: what they share, less the camera's error.
    - `camera`: that error.
    """

    channel: tuple[Float[np.ndarray, "_times _channels"], ...]
    common_mode: tuple[Float[np.ndarray, " _times"], ...]
    camera: tuple[Float[np.ndarray, " _times"], ...]


def split_residuals(result: DescentResult) -> Residuals:
    """The residuals where a descent ended."""
    found: dict[int, tuple[np.ndarray, ...]] = {}
    with own_settings():
        for group, difference in zip(result.objective.groups, result.differences, strict=True):
            channel, common_mode, sizes = jax.vmap(lambda w, d: w.split(d))(
                group.weights, difference
            )
            error = np.einsum("rtk,rk->rt", np.asarray(group.weights.shapes), np.asarray(sizes))
            times = np.asarray(group.lengths)
            for row, position in enumerate(group.positions):
                parts = (np.asarray(channel[row]), np.asarray(common_mode[row]), error[row])
                found[position] = tuple(part[: times[row]] for part in parts)
    ordered = [found[position] for position in sorted(found)]
    return Residuals(*zip(*ordered, strict=True))


def solved_temperatures(result: DescentResult) -> list[Float[np.ndarray, "times channels"]]:
    """What the twin reads in each recording where a descent ended, degC."""
    found: dict[int, np.ndarray] = {}
    for group, difference in zip(result.objective.groups, result.differences, strict=True):
        for row, position in enumerate(group.positions):
            times = slice(int(group.lengths[row]))  # without the samples that fill up their number
            read = np.asarray(difference[row]) + np.asarray(group.temperatures[row])
            found[position] = read[times]
    return [found[position] for position in sorted(found)]


def update_noise_model(
    problem: MatchProblem, noise_model: NoiseModel, result: DescentResult
) -> NoiseModel:
    """What the residuals of a descent tell: corrections, noise, outliers."""
    channel, common_mode, errors = split_residuals(result)
    events = noise_model.events
    if problem.common_error is not None and problem.events is None:
        # What is recorded less what is simulated, with the camera's error still in it.
        events = tuple(
            detect_events(
                experiment.time,
                -shared_residual(one, shared, error, weight),
                np.count_nonzero(weight, axis=1) > 0,
            )
            for experiment, one, shared, error, weight in zip(
                problem.experiments,
                channel,
                common_mode,
                errors,
                problem.sample_weights,
                strict=True,
            )
        )
    channel_weights = problem.sample_weights
    common_mode_weights = tuple(np.ones(len(one)) for one in common_mode)
    if problem.robust is not None:
        # A single channel has nothing alone.
        channel_weights = tuple(
            given * huber_weights(one, problem.robust, beside_others(given))
            if one.shape[1] > 1
            else given
            for given, one in zip(problem.sample_weights, channel, strict=True)
        )
        common_mode_weights = tuple(
            huber_weights(one, problem.robust, given.sum(axis=1) > 0)
            for given, one in zip(problem.sample_weights, common_mode, strict=True)
        )
    noise = residual_noise(channel, common_mode, channel_weights, common_mode_weights)
    # Residuals that are nothing tell no noise to weigh by.
    of_channel, of_common = (
        found if found.standard_deviation > 0 else before
        for found, before in zip(noise, (noise_model.channel, noise_model.common_mode), strict=True)
    )
    return NoiseModel(of_channel, of_common, events, channel_weights, common_mode_weights)


def shared_residual(
    channel: Float[np.ndarray, "times channels"],
    common_mode: Float[np.ndarray, " times"],
    camera: Float[np.ndarray, " times"],
    samples: Float[np.ndarray, "times channels"],
) -> Float[np.ndarray, " times"]:
    """The mean of the channels' residuals, with what does not count between its neighbours, K.

    Where a channel begins or ends to count, a mean of the others alone would jump.
    """
    shared = common_mode + camera
    if (samples > 0).all():
        return shared
    whole, times = channel + shared[:, None], np.arange(len(shared))
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
    channel: Sequence[Float[np.ndarray, "_times _channels"]],
    common_mode: Sequence[Float[np.ndarray, " _times"]],
    channel_weights: Sequence[Float[np.ndarray, "_times _channels"]],
    common_mode_weights: Sequence[Float[np.ndarray, " _times"]],
) -> tuple[Noise, Noise]:
    """The noise of both parts of the residuals; where no two channels count at the same time, the
    first part is nothing and takes after the second."""
    several, counted = [], 0.0
    for one, weights in zip(channel, channel_weights, strict=True):
        beside = beside_others(weights)
        if beside.any():
            # Deviations from a mean of n channels vary less than the channels do, by (n - 1) / n.
            n = np.maximum(beside.sum(axis=1, keepdims=True), 2)
            several.append(one * np.sqrt(weights * beside * n / (n - 1)))
            counted += float(np.sum(weights * beside))
    shared = [
        (one * np.sqrt(w * v.sum(axis=1)))[:, None]
        for one, w, v in zip(common_mode, common_mode_weights, channel_weights, strict=True)
    ]
    # Samples that do not count are no samples.
    counts = [v.sum(axis=1) > 0 for v in channel_weights]
    of_common = estimate_noise(shared, float(sum(one.sum() for one in counts)))
    if not several:
        return of_common, of_common
    return estimate_noise(several, counted), of_common
