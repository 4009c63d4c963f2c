"""The causes of what changes in an observed recording, one after the other."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from .._jax_settings import own_settings
from ..monitoring._monitor import SETTLE
from ..monitoring._thresholds import DAY
from ..observers import Observed
from ._diagnosis import HEALTHY, NONE_OF_THESE, Cause, Diagnosis, Explanation
from ._likelihood_ratio import Judged, Prior, ratios
from ._recorded import inputs_of
from ._signatures import Suspected
from ._survivors import Survivors, survivors
from ._suspects import Suspect

# The mean time between two faults, s, as between two false alarms of a monitor.
MEAN_SECONDS_BETWEEN_FAULTS = 30 * DAY

# Logarithm of the odds from which on something has changed: 95 %.
LOG_ODDS_95 = math.log(19.0)

# A fault has to show itself within this time, s.
PATIENCE = 600.0

# A fault is over when so much of the logarithm of its odds is lost, and a tenth of it.
OVER = 10.0

# A fault that is over is followed for so many samples more, to see when it ended.
AFTER = 30

# None of the suspects is the cause if the best leaves more than this multiple of the squares of
# noise, and more than this part of what is beyond noise. The lid of a real box, which is not quite
# any suspect, leaves 0.17 at most, and two faults at once on a bench 0.08; readings that are
# mirrored or exchanged, or another rig's, leave 0.22 and more, but for the 45 s after readings of
# two cells are mirrored, with 0.19.
FOREIGN, LEFT = 2.0, 0.2

# The largest number of causes in a recording.
MOST = 8


@dataclass(frozen=True)
class _Span:
    """The samples at which something was found, at which most was known of it, and after it was
    over; and whether it is over."""

    found: int
    best: int
    end: int
    is_over: bool


def diagnosed(
    observed: Observed, several: Sequence[Suspect], arrays: Suspected, prior: Prior
) -> Diagnosis:
    """Diagnoses an observed recording."""
    time = np.interp(np.cumsum(observed.samples.dt), observed.experiment.elapsed, observed.time)
    start = int(np.searchsorted(time, time[0] + SETTLE))
    step = float(np.median(np.diff(observed.time)))
    rate = math.log(step / MEAN_SECONDS_BETWEEN_FAULTS / (len(several) + 1))
    prior = prior._replace(patience=np.asarray(PATIENCE / step), enough=np.asarray(-rate))
    answers = np.zeros((len(time), len(several) + 2))
    answers[:, -1] = 1.0
    causes: list[Cause] = []
    while start < len(time) and len(causes) < MOST:
        with own_settings():
            result = ratios(observed.observer, arrays, prior, inputs_of(observed, start))
        said = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(time)], result)
        logs = np.asarray(said.evidence) + rate
        span = _first(logs, start)
        end = len(time) if span is None else span.end
        answers[start:end] = _probabilities(logs[start:end])
        if span is None:
            break
        last = min(span.end + AFTER, len(time)) - 1 if span.is_over else span.best
        alive = survivors(observed, several, prior, said, logs, span.best, last, span.is_over)
        odds = _odds(alive, said, logs, span.best, rate)
        posterior = _probabilities(odds)
        answers[alive.first : alive.first + len(posterior)] = posterior
        causes.append(_cause(several, alive, said, logs, span, posterior[-1], time))
        start = int(np.searchsorted(time, time[min(end, len(time) - 1)] + SETTLE))
    names = (*(suspect.name for suspect in several), NONE_OF_THESE, HEALTHY)
    return Diagnosis(
        observed, tuple(several), tuple(causes), names, answers[np.asarray(observed.is_sample)]
    )


def _first(logs: Float[np.ndarray, "samples faults"], start: int) -> _Span | None:
    """The first change; None for none."""
    total = np.logaddexp.reduce(logs, axis=1)
    above = np.flatnonzero(total[start:] > LOG_ODDS_95)
    if not len(above):
        return None
    result = start + int(above[0])
    peaks = np.maximum.accumulate(total[result:])
    lost = np.flatnonzero(total[result:] < peaks - OVER - 0.1 * peaks)
    end = result + int(lost[0]) if len(lost) else len(total)
    best = result + int(np.argmax(total[result:end]))
    return _Span(result, best, end, bool(len(lost)))


def _odds(
    alive: Survivors,
    said: Judged,
    logs: Float[np.ndarray, "samples faults_and_other"],
    at: int,
    rate: float,
) -> Float[np.ndarray, "followed faults_and_other"]:
    """The logarithms of the odds of the survivors, and of none of them, against no fault, from the
    first onset on."""
    other = logs.shape[1] - 1
    # How many onsets there are beside the one that was followed.
    onsets = np.asarray(said.evidence - said.ratio)[at, alive.numbers] + rate
    count = alive.evidence.shape[1]
    odds = np.full((count, other + 1), -math.inf)
    odds[:, alive.numbers] = (alive.evidence / alive.excess + onsets[:, None]).T
    of_other = logs[alive.first : alive.first + count, other]
    if alive.excess > FOREIGN and alive.left > LEFT:
        # The best of many wrong faults explains more than none: it has to explain nearly all.
        of_other = np.maximum(of_other, alive.scatter + rate)
    odds[:, other] = (of_other - rate) / alive.excess + rate
    return odds


def _cause(
    several: Sequence[Suspect],
    alive: Survivors,
    said: Judged,
    logs: Float[np.ndarray, "samples faults_and_other"],
    span: _Span,
    probabilities: Float[np.ndarray, " answers"],
    time: Float[np.ndarray, " samples"],
) -> Cause:
    other = len(several)
    explained: dict[int, Explanation] = {}
    for place, number in enumerate(alive.numbers.tolist()):
        if number not in explained:
            times = _onset(said, span.best, number, int(alive.onset[place]), time)
            one, size = several[number], alive.size(place)
            explained[number] = Explanation(
                one.name, float(probabilities[number]), *size, one.none, one.unit, *times
            )
    first = int(np.asarray(said.onset)[span.best, other])
    times = _onset(said, span.best, other, first, time)
    unknown = math.nan, math.nan, math.nan
    none = Explanation(NONE_OF_THESE, float(probabilities[other]), *unknown, math.nan, "", *times)
    order = sorted([*explained.values(), none], key=lambda one: -one.probability)
    begin = first
    if order[0] is not none:
        begin = int(alive.onset[np.argmax(probabilities[alive.numbers])])
    is_sure = np.logaddexp.reduce(logs[begin : span.best + 1], axis=1) > LOG_ODDS_95
    result = begin + int(is_sure.argmax()) if is_sure.any() else span.found
    until = float(time[alive.first + alive.evidence.shape[1] - 1]) if span.is_over else None
    return Cause(tuple(order), float(time[result]), until, alive.excess)


def _onset(
    said: Judged, at: int, number: int, first: int, time: Float[np.ndarray, " samples"]
) -> tuple[float, float, float]:
    """The time of an onset with its band, for the number of the first sample that shows it: it was
    after the sample before."""
    earliest = min(int(np.asarray(said.earliest)[at, number]), first)
    latest = max(int(np.asarray(said.latest)[at, number]), first)
    return float(time[first] + time[first - 1]) / 2, float(time[earliest - 1]), float(time[latest])


def _probabilities(
    logs: Float[np.ndarray, "samples faults"],
) -> Float[np.ndarray, "samples answers"]:
    """The probabilities of the faults and, last, of no fault, from the logarithms of the odds
    against no fault."""
    both = np.concatenate([logs, np.zeros((len(logs), 1))], axis=1)
    return np.exp(both - np.logaddexp.reduce(both, axis=1, keepdims=True))
