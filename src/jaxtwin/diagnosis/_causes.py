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
from ._likelihood_ratio import LikelihoodRatios, Prior, ratios
from ._recorded import inputs_of
from ._signatures import Suspected
from ._survivors import Survivors, track_candidates
from ._suspects import Suspect

# The mean time between two faults, s, as between two false alarms of a monitor.
MEAN_SECONDS_BETWEEN_FAULTS = 30 * DAY

# Logarithm of the odds from which on something has changed: 95 %.
LOG_ODDS_95 = math.log(19.0)

# A fault has to show itself within this time, s.
PATIENCE = 600.0

# A fault is over when the logarithm of its odds has fallen by this number and a tenth of its peak.
ODDS_DROP = 10.0

# The number of samples for which a fault that is over is still followed, to see when it ended.
SAMPLES_AFTER_END = 30

# None of the suspects is the cause if the best leaves more than this multiple of the squares of
# noise, and more than this part of what is beyond noise. The lid of a real box, which is not quite
# any suspect, leaves 0.17 at most, and two faults at once on a bench 0.08; readings that are
# mirrored or exchanged, or another rig's, leave 0.22 and more, but for the 45 s after readings of
# two cells are mirrored, with 0.19.
MAX_EXCESS, MAX_UNEXPLAINED = 2.0, 0.2

# The largest number of causes in a recording.
MAX_CAUSES = 8


@dataclass(frozen=True)
class _Span:
    """The samples at which something was found, at which most was known of it, and after it was
    over; and whether it is over."""

    found: int
    best: int
    end: int
    is_over: bool


def diagnosed(
    observed: Observed, suspects: Sequence[Suspect], arrays: Suspected, prior: Prior
) -> Diagnosis:
    """Diagnoses an observed recording."""
    time = np.interp(np.cumsum(observed.samples.dt), observed.experiment.elapsed, observed.time)
    start = int(np.searchsorted(time, time[0] + SETTLE))
    step = float(np.median(np.diff(observed.time)))
    rate = math.log(step / MEAN_SECONDS_BETWEEN_FAULTS / (len(suspects) + 1))
    prior = prior._replace(patience=np.asarray(PATIENCE / step), forget_below=np.asarray(-rate))
    answers = np.zeros((len(time), len(suspects) + 2))
    answers[:, -1] = 1.0
    causes: list[Cause] = []
    while start < len(time) and len(causes) < MAX_CAUSES:
        with own_settings():
            result = ratios(observed.observer, arrays, prior, inputs_of(observed, start))
        scores = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(time)], result)
        log_odds = np.asarray(scores.evidence) + rate
        span = _first(log_odds, start)
        end = len(time) if span is None else span.end
        answers[start:end] = _probabilities(log_odds[start:end])
        if span is None:
            break
        last = min(span.end + SAMPLES_AFTER_END, len(time)) - 1 if span.is_over else span.best
        survivors = track_candidates(
            observed, suspects, prior, scores, log_odds, span.best, last, span.is_over
        )
        odds = _odds(survivors, scores, log_odds, span.best, rate)
        posterior = _probabilities(odds)
        answers[survivors.first : survivors.first + len(posterior)] = posterior
        causes.append(_cause(suspects, survivors, scores, log_odds, span, posterior[-1], time))
        start = int(np.searchsorted(time, time[min(end, len(time) - 1)] + SETTLE))
    names = (*(suspect.name for suspect in suspects), NONE_OF_THESE, HEALTHY)
    return Diagnosis(
        observed, tuple(suspects), tuple(causes), names, answers[np.asarray(observed.is_sample)]
    )


def _first(log_odds: Float[np.ndarray, "samples faults"], start: int) -> _Span | None:
    """The first change; None for none."""
    total = np.logaddexp.reduce(log_odds, axis=1)
    above = np.flatnonzero(total[start:] > LOG_ODDS_95)
    if not len(above):
        return None
    result = start + int(above[0])
    peaks = np.maximum.accumulate(total[result:])
    lost = np.flatnonzero(total[result:] < peaks - ODDS_DROP - 0.1 * peaks)
    end = result + int(lost[0]) if len(lost) else len(total)
    best = result + int(np.argmax(total[result:end]))
    return _Span(result, best, end, bool(len(lost)))


def _odds(
    survivors: Survivors,
    scores: LikelihoodRatios,
    log_odds: Float[np.ndarray, "samples faults_and_other"],
    at: int,
    rate: float,
) -> Float[np.ndarray, "followed faults_and_other"]:
    """The logarithms of the odds of the survivors, and of none of them, against no fault, from the
    first onset on."""
    other = log_odds.shape[1] - 1
    # The logarithm of the number of possible onsets, of which a filter has followed one.
    onsets = np.asarray(scores.evidence - scores.ratio)[at, survivors.numbers] + rate
    count = survivors.evidence.shape[1]
    odds = np.full((count, other + 1), -math.inf)
    odds[:, survivors.numbers] = (survivors.evidence / survivors.excess + onsets[:, None]).T
    of_other = log_odds[survivors.first : survivors.first + count, other]
    if survivors.excess > MAX_EXCESS and survivors.unexplained > MAX_UNEXPLAINED:
        # The best of many wrong faults explains more than none: it has to explain nearly all.
        of_other = np.maximum(of_other, survivors.scatter + rate)
    odds[:, other] = (of_other - rate) / survivors.excess + rate
    return odds


def _cause(
    suspects: Sequence[Suspect],
    survivors: Survivors,
    scores: LikelihoodRatios,
    log_odds: Float[np.ndarray, "samples faults_and_other"],
    span: _Span,
    probabilities: Float[np.ndarray, " answers"],
    time: Float[np.ndarray, " samples"],
) -> Cause:
    """What is known of a change: its explanations by their probability, and its time."""
    other = len(suspects)
    explained: dict[int, Explanation] = {}
    for place, number in enumerate(survivors.numbers.tolist()):
        if number not in explained:
            times = _onset(scores, span.best, number, int(survivors.onset[place]), time)
            suspect, size = suspects[number], survivors.size(place)
            explained[number] = Explanation(
                suspect.name,
                float(probabilities[number]),
                *size,
                suspect.none,
                suspect.unit,
                *times,
            )
    first = int(np.asarray(scores.onset)[span.best, other])
    times = _onset(scores, span.best, other, first, time)
    unknown = math.nan, math.nan, math.nan
    none = Explanation(NONE_OF_THESE, float(probabilities[other]), *unknown, math.nan, "", *times)
    order = sorted([*explained.values(), none], key=lambda explanation: -explanation.probability)
    begin = first
    if order[0] is not none:
        begin = int(survivors.onset[np.argmax(probabilities[survivors.numbers])])
    is_sure = np.logaddexp.reduce(log_odds[begin : span.best + 1], axis=1) > LOG_ODDS_95
    result = begin + int(is_sure.argmax()) if is_sure.any() else span.found
    until = float(time[survivors.first + survivors.evidence.shape[1] - 1]) if span.is_over else None
    return Cause(tuple(order), float(time[result]), until, survivors.excess)


def _onset(
    scores: LikelihoodRatios, at: int, number: int, first: int, time: Float[np.ndarray, " samples"]
) -> tuple[float, float, float]:
    """The time of an onset with its band, for the number of the first sample that shows it: it was
    after the sample before."""
    earliest = min(int(np.asarray(scores.earliest)[at, number]), first)
    latest = max(int(np.asarray(scores.latest)[at, number]), first)
    return float(time[first] + time[first - 1]) / 2, float(time[earliest - 1]), float(time[latest])


def _probabilities(
    log_odds: Float[np.ndarray, "samples faults"],
) -> Float[np.ndarray, "samples answers"]:
    """The probabilities of the faults and, last, of no fault, from the logarithms of the odds
    against no fault."""
    both = np.concatenate([log_odds, np.zeros((len(log_odds), 1))], axis=1)
    return np.exp(both - np.logaddexp.reduce(both, axis=1, keepdims=True))
