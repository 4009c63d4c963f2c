"""Mistakes of a recording that a refit would otherwise take for a change of the rig.

A duty that was written in other counts looks like another cell, an open lid that the recording
calls closed like another loss, exchanged channels like a plate that conducts differently, and an
error that all sensors share (`_sensor_errors`) like another supply. Each mistake is a rival of the
refit: the recording without it, matched from the same prior with nothing released. If the rival
explains the recording better, there is nothing to learn.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..io import Experiment
from ..matching import DescentResult, Fit, NoiseModel, room_temperature
from ..observers import ProcessNoise
from ..rig import Input
from ._forgetting import SessionPrior
from ._held_out import HeldOutReplay, replay
from ._sensor_errors import SENSOR_ERRORS, SensorError, smallest
from ._session_match import SessionMatch, descend_each, match_session, session_problem

Vector = Float[np.ndarray, " unknowns"]

# Factors of the duty that are tried: a reversed one, and other full counts.
DUTY_FACTORS = (-1.0, 0.4, 0.5, 0.625, 0.8, 1.25, 1.6, 2.2)

# Those next to 1.
BESIDE = (0.8, 1.25)

# The logarithms of further factors around the best of these.
NEIGHBOURS = (-0.16, -0.08, 0.0, 0.08, 0.16)

# With more channels, only neighbours in the order of the rig are exchanged.
MAX_CHANNELS = 8

# A rival that explains a recording is near after a few steps.
ITERATIONS = 4

# The limit for the match of a rival that then predicts what was held out.
DRIFT_ITERATIONS = 20

# A rival wins by this difference of the logarithm of its probability, a factor of 20.
BETTER = 3.0

# Where nothing has changed, a rival is worth a look from this difference on, a factor of e.
POSSIBLE = 1.0


@final
class Mistake(NamedTuple):
    """A mistake of a recording.

    - `sentence`: what would be wrong, as the end of a sentence.
    - `cost`: half the sum of squared residuals and priors without it.
    - `corrected`: a recording -> the recording without it.
    - `gain`: the factor by which its readings are too large.
    """

    sentence: str
    cost: float
    corrected: Callable[[Experiment], Experiment]
    gain: float = 1.0


def likely_mistakes(
    fit: Fit, prior: SessionPrior, match: SessionMatch, recordings: dict[str, Experiment]
) -> list[Mistake]:
    """The mistake that explains recordings best, and those that are about as good, the best
    first."""
    result = [_sensor_error(model, fit, prior, match, recordings) for model in SENSOR_ERRORS]
    if any(np.any(recording.duty) for recording in recordings.values()):
        result.append(_wrong_duty(fit, prior, match, recordings))
    for sentence, corrected in _rivals(fit, recordings):
        (cost,) = _costs(_descents(fit, prior, match, [_each(recordings, corrected)], match.start))
        result.append(Mistake(sentence, cost, corrected))
    result.sort(key=lambda mistake: mistake.cost)
    return [mistake for mistake in result if mistake.cost <= result[0].cost + BETTER]


def with_held_out_costs(
    mistakes: Sequence[Mistake],
    fit: Fit,
    prior: SessionPrior,
    recordings: dict[str, Experiment],
    held_out: Sequence[tuple[Experiment, float, HeldOutReplay]],
    noise: ProcessNoise | None,
    lead: float,
) -> list[Mistake]:
    """Mistakes with the costs of what was held out, beside those of what was seen: a change of the
    rig predicts it, and a mistake that explains what was seen by chance does not.

    **Arguments:**

    - `recordings`: what was seen.
    - `held_out`: recordings, the time of each from which they were not seen, and how the new twin
      follows them.
    """
    result = []
    for mistake in mistakes:
        cost = mistake.cost
        # The new twin has drifted with the session, and so must its rival.
        seen = _each(recordings, mistake.corrected)
        drifted = match_session(fit, prior, seen, 0, DRIFT_ITERATIONS).fit
        for recording, since, new in held_out:
            corrected = mistake.corrected(recording)
            begin = float(corrected.time[np.searchsorted(recording.time, since)])
            rival = replay(drifted, corrected, begin, noise, lead)
            # The density of a reading is that of the corrected one, which is spread less widely.
            density = rival.log_likelihood - rival.readings * math.log(mistake.gain)
            cost += (new.log_likelihood - density) / new.correlation
        result.append(mistake._replace(cost=cost))
    return sorted(result, key=lambda mistake: mistake.cost)


def _each(
    recordings: dict[str, Experiment], corrected: Callable[[Experiment], Experiment]
) -> dict[str, Experiment]:
    return {name: corrected(recording) for name, recording in recordings.items()}


def _sensor_error(
    error: SensorError,
    fit: Fit,
    prior: SessionPrior,
    match: SessionMatch,
    recordings: dict[str, Experiment],
) -> Mistake:
    """An error of all sensors, of the size that explains recordings best."""
    # The room of an unrecorded one is that of the match, the same for all recordings of a session.
    twin = next(iter(match.fit.twins.values()))
    room = room_temperature(fit.twin.rig, twin.numbers_si, None)

    def without(size: float) -> Callable[[Experiment], Experiment]:
        return lambda recording: error.corrected(recording, room, size)

    def costs(sizes: Sequence[float]) -> list[float]:
        result = []
        for size in sizes:
            problem = session_problem(fit, prior, _each(recordings, without(size)))
            model = _of_corrected(
                match.noise_model, recordings, error.gain(size), error.clock(size)
            )
            result += descend_each([problem], model, match.start, ITERATIONS)
        return _costs(result)

    size, cost = smallest(costs, error, match.drift_cost)
    has_room = any(recording.ambient is not None for recording in recordings.values())
    return Mistake(error.sentence(size, has_room), cost, without(size), error.gain(size))


def _of_corrected(
    model: NoiseModel, recordings: dict[str, Experiment], gain: float, rate: float
) -> NoiseModel:
    """The noise model of recordings without a gain and a rate of the clock.

    Readings that are divided by a gain have a noise that is divided by it; with the old one the
    largest gain would explain any noise best. The camera's corrections move with the clock.
    """
    events = tuple(
        tuple(float(recording.time[0] + (time - recording.time[0]) / rate) for time in times)
        for recording, times in zip(recordings.values(), model.events, strict=True)
    )
    channel, common = model.channel, model.common_mode
    return replace(
        model,
        channel=replace(channel, standard_deviation=channel.standard_deviation / gain),
        common_mode=replace(common, standard_deviation=common.standard_deviation / gain),
        events=events,
    )


def _wrong_duty(
    fit: Fit, prior: SessionPrior, match: SessionMatch, recordings: dict[str, Experiment]
) -> Mistake:
    """The factor of the duty that explains recordings best: the nearest of a few, then others
    around it, and the minimum of the parabola through the best three of these."""
    lowest = np.array(fit.twin.rig.lowest_duty)

    def times(factor: float) -> Callable[[Experiment], Experiment]:
        return lambda recording: replace(
            recording, duty=np.clip(factor * recording.duty, lowest, 1.0)
        )

    def descents(factors: Sequence[float], start: Vector) -> list[DescentResult]:
        corrected = [_each(recordings, times(factor)) for factor in factors]
        return _descents(fit, prior, match, corrected, start)

    def mistake(factor: float, cost: float) -> Mistake:
        return Mistake(_duty_sentence(factor), cost, times(factor))

    if not match.changed and match.explanation.is_enough:
        # The recorded duty is near: the minimum is between its neighbours if both are worse.
        beside = _costs(descents(BESIDE, match.start))
        if min(beside) >= match.drift_cost:
            return mistake(BESIDE[int(np.argmin(beside))], min(beside))
    coarse = descents(DUTY_FACTORS, match.start)
    best = int(np.argmin(_costs(coarse)))
    nearest, start = DUTY_FACTORS[best], coarse[best].vector
    if coarse[best].cost >= match.drift_cost:  # the duty as it is recorded is nearer
        return mistake(nearest, coarse[best].cost)
    fine = np.array(_costs(descents([nearest * float(np.exp(n)) for n in NEIGHBOURS], start)))
    middle = int(np.clip(np.argmin(fine), 1, len(fine) - 2))
    left, centre, right = fine[middle - 1 : middle + 2]
    curvature, slope = left - 2 * centre + right, (right - left) / 2
    cost, moved = centre, 0.0
    if np.isfinite(curvature) and curvature > 0:
        moved = float(np.clip(-slope / curvature, -1.0, 1.0))
        cost = centre + slope * moved + curvature * moved**2 / 2
    factor = nearest * np.exp(NEIGHBOURS[middle] + moved * (NEIGHBOURS[1] - NEIGHBOURS[0]))
    return mistake(float(factor), float(max(cost, 0.0)))


def _duty_sentence(factor: float) -> str:
    what = "had the other sign" if factor < 0 else f"were {factor:.2g} times as large"
    return f"if its duty {what}"


def _descents(
    fit: Fit,
    prior: SessionPrior,
    match: SessionMatch,
    several: Sequence[dict[str, Experiment]],
    start: Vector,
) -> list[DescentResult]:
    """Matches of several corrected recordings from a prior."""
    problems = [session_problem(fit, prior, corrected) for corrected in several]
    return descend_each(problems, match.noise_model, start, ITERATIONS)


def _costs(results: Sequence[DescentResult]) -> list[float]:
    """The costs of descents, infinite where there are no finite temperatures."""
    return [each.cost if np.isfinite(each.cost) else np.inf for each in results]


def _rivals(
    fit: Fit, recordings: dict[str, Experiment]
) -> Iterator[tuple[str, Callable[[Experiment], Experiment]]]:
    """Each mistake that has no size, and a recording as it would be without it."""
    for pair in _exchanges(recordings):
        yield (
            f"if its channels {pair[0]} and {pair[1]} were exchanged",
            partial(_exchanged, pair=pair),
        )
    for row in fit.twin.rig.inputs:
        if any(row.name in recording.inputs for recording in recordings.values()):
            for number, state in enumerate(row.states):
                if all(
                    np.all(_numbers(recording, row) == number) for recording in recordings.values()
                ):
                    continue  # which is what they say
                yield f"if {row.name} were {state}", partial(_in_state, name=row.name, state=state)


def _in_state(recording: Experiment, name: str, state: str) -> Experiment:
    return recording.with_inputs(**{name: state})


def _numbers(recording: Experiment, row: Input) -> Float[np.ndarray, " times"]:
    """The numbers of the states of an input at each time."""
    levels = np.asarray(recording.inputs.get(row.name, row.value))
    if levels.dtype.kind in "iuf":
        return levels.astype(float)
    return np.array([row.states.index(str(level)) for level in levels.ravel()], float)


def _exchanges(recordings: dict[str, Experiment]) -> list[tuple[str, str]]:
    """The pairs of channels that all recordings have."""
    first, *others = recordings.values()
    names = [name for name in first.channels if all(name in other.channels for other in others)]
    if len(names) <= MAX_CHANNELS:
        return list(combinations(names, 2))
    return list(pairwise(names))


def _exchanged(recording: Experiment, pair: tuple[str, str]) -> Experiment:
    places = list(range(len(recording.channels)))
    a, b = (recording.channels.index(name) for name in pair)
    places[a], places[b] = b, a
    assert recording.temperatures is not None
    return replace(recording, temperatures=np.asarray(recording.temperatures)[:, places])
