"""The causes of what changes in an observed recording, one after the other."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.special import log_ndtr

from .._jax_settings import own_settings
from .._statistics import QUANTILE_975
from ..monitoring._monitor import SETTLE
from ..monitoring._thresholds import DAY
from ..observers import Observed
from ._diagnosis import HEALTHY, NONE_OF_THESE, Cause, Diagnosis, Explanation
from ._hypotheses import Hypotheses, Tracked, tracked
from ._likelihood_ratio import LikelihoodRatios, Prior, ratios
from ._recorded import filled_up, inputs_of
from ._signatures import Suspected, suspected
from ._suspects import Suspect

# The number of faults that are followed.
SURVIVORS = 6

# The number of equal readings from which on a channel may be stuck.
MIN_EQUAL_READINGS = 10

# A size that differs from that of its filter by less than this part needs no other filter.
REFILTER_FRACTION = 0.25

# The largest number of times that the filters run.
MAX_ROUNDS = 3

# A fault whose logarithm of the likelihood is so far below the best needs no other filter.
DEAD = 10.0

# The largest multiple of what a filter is made for.
MAX_SIZE_MULTIPLE = 50.0

# The part of the largest multiple of a factor that a filter is made for: the factor would be
# infinite or 0 there.
MAX_FACTOR_FRACTION = 0.98

# The smallest multiple of a usual effect for which a filter is made: none would be no fault.
MIN_SIZE_MULTIPLE = 0.05


@dataclass(frozen=True)
class Survivors:
    """Faults with what their filters say.

    - `numbers`: of the suspects; the same may be there several times. `sized`: the suspects of the
      sizes for which their filters were made.
    - `first`: the number of the first sample that they followed. `onset`: that of the first sample
      with each fault.
    - `evidence`: the logarithm of the ratio of the likelihoods with and without each fault after
      each sample, until most was known.
    - `multiple`, `spread`: of the fault at the end, and its standard deviation.
    - `excess`: how much larger the mean square of the innovations of the best is than it should be;
      no fault is better known than the best of them explains the readings.
    - `left`: the part of the squares of the innovations beyond noise that the best leaves.
    - `scatter`: the logarithm of the ratio of the likelihoods if the innovations were noise that
      has become larger, for no reason that is known, and without any fault.
    """

    numbers: Int[np.ndarray, " candidates"]
    sized: tuple[Suspect, ...]
    first: int
    onset: Int[np.ndarray, " candidates"]
    evidence: Float[np.ndarray, "candidates samples"]
    multiple: Float[np.ndarray, " candidates"]
    spread: Float[np.ndarray, " candidates"]
    excess: float
    left: float
    scatter: Float[np.ndarray, " samples"]

    def size(self, place: int) -> tuple[float, float, float]:
        """The size of a fault, and its 95 % band."""
        suspect, middle = self.sized[place], float(self.multiple[place])
        half = QUANTILE_975 * float(self.spread[place])
        one_end, other = suspect.size_of(middle - half), suspect.size_of(middle + half)
        return suspect.size_of(middle), min(one_end, other), max(one_end, other)


def track_candidates(
    observed: Observed,
    several: Sequence[Suspect],
    prior: Prior,
    scores: LikelihoodRatios,
    logs: Float[np.ndarray, "samples faults_and_other"],
    at: int,
    last: int,
    is_over: bool,
) -> Survivors:
    """Follows the faults that explain a change best.

    **Arguments:**

    - `scores`: the likelihood ratios. `logs`: the logarithms of the odds that follow from them.
    - `at`: the sample at which these are largest. `last`: the last one that is followed.
    - `is_over`: whether the fault ended before that.
    """
    # A candidate of the very sample at which a channel was stuck may be gone.
    stuck = _stuck(observed, several, at)
    order = [number for number in np.argsort(-logs[at, :-1]).tolist() if number not in stuck]
    numbers = np.resize([*stuck, *order][:SURVIVORS], SURVIVORS)  # the same number for few suspects
    onset = np.asarray(scores.onset)[at, numbers]
    onset = np.array([stuck.get(n, first) for n, first in zip(numbers, onset, strict=True)])
    inflation = np.asarray(prior.inflation)[numbers]
    suspects = [several[int(number)] for number in numbers]
    multiples = np.asarray(scores.multiple)[at, numbers]
    sized = [
        _of_multiple(suspect, float(multiple))
        for suspect, multiple in zip(suspects, multiples, strict=True)
    ]
    turn = 0
    while True:
        turn += 1
        rows = slice(int(onset.min()) - 1, last + 1)
        # The ratio, which is linear in the fault, sees a large one a sample late.
        begins = np.concatenate([onset, onset - 1])
        effects = [
            abs(suspect.multiple_of(now.size)) for suspect, now in zip(suspects, sized, strict=True)
        ]
        spread = np.tile(np.asarray(prior.spread)[numbers] / effects, 2)
        candidates = _follow(observed, 2 * sized, spread, begins, rows)
        each = (
            _evidence(observed, 2 * sized, candidates, begins, rows)
            / np.tile(inflation, 2)[:, None]
        )
        # Most is known when the fault ends: what comes after it speaks against it.
        most = int(each.max(axis=0).argmax()) if is_over else each.shape[1] - 1
        is_earlier = each[SURVIVORS:, most] > each[:SURVIVORS, most]
        picked = np.arange(SURVIVORS) + SURVIVORS * is_earlier
        onset, evidence = begins[picked], each[picked, : most + 1]
        of_each = jax.tree.map(lambda leaf, now=(picked, most): leaf[now], candidates)
        is_alive = evidence[:, -1] > evidence[:, -1].max() - DEAD
        is_done = (np.abs(of_each.multiple - 1) < REFILTER_FRACTION) & ~is_earlier
        if turn == MAX_ROUNDS or (is_done | ~is_alive).all():
            break
        sized = [
            _of_multiple(suspect, float(multiple)) if is_kept else suspect
            for suspect, multiple, is_kept in zip(sized, of_each.multiple, is_alive, strict=True)
        ]
    best = int(evidence[:, -1].argmax())
    excess = max(1.0, float(of_each.misfit[best] / inflation[best]))
    variance, scatter = _scatter(
        observed, int(onset[best]), slice(rows.start, rows.start + most + 1), inflation[best]
    )
    left = (excess - 1) / max(variance - 1, excess - 1, 1e-9)
    return Survivors(
        numbers, tuple(sized), rows.start, onset, evidence, of_each.multiple,
        of_each.spread * np.sqrt(inflation * excess), excess, left, scatter,
    )  # fmt: skip


def _scatter(
    observed: Observed, onset: int, rows: slice, inflation: float
) -> tuple[float, Float[np.ndarray, " samples"]]:
    """The variance of the innovations without a fault since an onset, as a multiple of that in
    healthy recordings and 1 at least, and the logarithm of the ratio of the likelihoods with it and
    with that of noise after each sample: n (v - 1 - log v) / 2."""
    whitened = np.asarray(observed.filtered.states.whitened)[rows]
    there = np.isfinite(np.asarray(observed.samples.readings)[rows]).sum(axis=1)
    is_after = np.arange(rows.start, rows.stop) >= onset
    squares = np.where(is_after, (whitened**2).sum(axis=1), 0.0).cumsum() / inflation
    count = np.where(is_after, there, 0).cumsum()
    variance = np.maximum(squares / np.maximum(count, 1), 1.0)
    return float(variance[-1]), count * (variance - 1 - np.log(variance)) / 2


def _stuck(observed: Observed, several: Sequence[Suspect], at: int) -> dict[int, int]:
    """The suspects that are stuck channels whose readings are the same for some time up to a
    sample, and the number of the second of these samples."""
    readings = np.asarray(observed.samples.readings)[: at + 1]
    result = {}
    for number, suspect in enumerate(several):
        if suspect.held in observed.channels:
            column = readings[:, observed.channels.index(suspect.held)]
            moved = np.flatnonzero(column != column[-1])
            second = int(moved[-1]) + 2 if len(moved) else 0
            if second and at - second >= MIN_EQUAL_READINGS:
                result[number] = second
    return result


def _follow(
    observed: Observed,
    sized: Sequence[Suspect],
    spread: Float[np.ndarray, " candidates"],
    onset: Int[np.ndarray, " candidates"],
    rows: slice,
) -> Tracked:
    """Runs the filters of some suspects over some samples."""
    model = observed.observer.model
    with own_settings():
        readings = np.nan_to_num(np.asarray(model.from_degC(observed.samples.readings)))
    hypotheses = Hypotheses(
        suspected(model, sized),
        onset,
        readings[onset],
        spread,
        np.array([0.0 if suspect.is_one_sided else -MAX_SIZE_MULTIPLE for suspect in sized]),
        np.array([min(suspect.largest, MAX_SIZE_MULTIPLE) for suspect in sized]),
    )
    length = 2 ** max(7, math.ceil(math.log2(rows.stop - rows.start)))
    befores, samples = filled_up(observed, rows.start, length)
    numbers = rows.start + np.arange(length)
    with own_settings():
        result = tracked(observed.observer, hypotheses, numbers, befores, samples)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:, : rows.stop - rows.start], result)


def _evidence(
    observed: Observed,
    sized: Sequence[Suspect],
    of_each: Tracked,
    onset: Int[np.ndarray, " candidates"],
    rows: slice,
) -> Float[np.ndarray, "candidates samples"]:
    """The logarithm of the ratio of the likelihoods with each fault and without any, from its onset
    to each sample."""
    without = np.asarray(observed.filtered.states.log_likelihood)[rows]
    place = np.arange(len(without)) + rows.start
    since = np.where(place >= onset[:, None], without, 0.0).cumsum(axis=1)
    gained = of_each.log_likelihood - since
    one_sided = np.array([suspect.is_one_sided for suspect in sized])[:, None]
    above = log_ndtr(of_each.multiple / of_each.spread) + math.log(2.0)
    gained = gained + np.where(one_sided, above, 0.0)
    return np.where(place >= onset[:, None], gained, 0.0)


def _of_multiple(suspect: Suspect, multiple: float) -> Suspect:
    """The suspect of the size that is a multiple of its own, within its bounds and not 0."""
    if suspect.held:  # it has no size
        return suspect
    largest = suspect.largest if suspect.unit == "share" else MAX_FACTOR_FRACTION * suspect.largest
    limited = min(
        max(multiple, MIN_SIZE_MULTIPLE if suspect.is_one_sided else -MAX_SIZE_MULTIPLE),
        largest,
        MAX_SIZE_MULTIPLE,
    )
    if abs(limited) < MIN_SIZE_MULTIPLE:
        limited = MIN_SIZE_MULTIPLE
    return replace(suspect, size=suspect.size_of(limited))


# The mean time between two faults, s, as between two false alarms of a monitor.
MEAN_SECONDS_BETWEEN_FAULTS = 30 * DAY

# Logarithm of the odds from which on something has changed: 95 %.
LOG_ODDS_95 = math.log(19.0)

# A fault has to show itself within this time, s.
PATIENCE = 600.0

# A fault is over when so much of the logarithm of its odds is lost, and a tenth of it.
OVER = 10.0

# The number of samples for which a fault that is over is still followed, to see when it ended.
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
    prior = prior._replace(patience=np.asarray(PATIENCE / step), forget_below=np.asarray(-rate))
    answers = np.zeros((len(time), len(several) + 2))
    answers[:, -1] = 1.0
    causes: list[Cause] = []
    while start < len(time) and len(causes) < MOST:
        with own_settings():
            result = ratios(observed.observer, arrays, prior, inputs_of(observed, start))
        scores = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(time)], result)
        logs = np.asarray(scores.evidence) + rate
        span = _first(logs, start)
        end = len(time) if span is None else span.end
        answers[start:end] = _probabilities(logs[start:end])
        if span is None:
            break
        last = min(span.end + AFTER, len(time)) - 1 if span.is_over else span.best
        alive = track_candidates(
            observed, several, prior, scores, logs, span.best, last, span.is_over
        )
        odds = _odds(alive, scores, logs, span.best, rate)
        posterior = _probabilities(odds)
        answers[alive.first : alive.first + len(posterior)] = posterior
        causes.append(_cause(several, alive, scores, logs, span, posterior[-1], time))
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
    scores: LikelihoodRatios,
    logs: Float[np.ndarray, "samples faults_and_other"],
    at: int,
    rate: float,
) -> Float[np.ndarray, "followed faults_and_other"]:
    """The logarithms of the odds of the survivors, and of none of them, against no fault, from the
    first onset on."""
    other = logs.shape[1] - 1
    # How many onsets there are beside the one that was followed.
    onsets = np.asarray(scores.evidence - scores.ratio)[at, alive.numbers] + rate
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
    scores: LikelihoodRatios,
    logs: Float[np.ndarray, "samples faults_and_other"],
    span: _Span,
    probabilities: Float[np.ndarray, " answers"],
    time: Float[np.ndarray, " samples"],
) -> Cause:
    other = len(several)
    explained: dict[int, Explanation] = {}
    for place, number in enumerate(alive.numbers.tolist()):
        if number not in explained:
            times = _onset(scores, span.best, number, int(alive.onset[place]), time)
            suspect, size = several[number], alive.size(place)
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
        begin = int(alive.onset[np.argmax(probabilities[alive.numbers])])
    is_sure = np.logaddexp.reduce(logs[begin : span.best + 1], axis=1) > LOG_ODDS_95
    result = begin + int(is_sure.argmax()) if is_sure.any() else span.found
    until = float(time[alive.first + alive.evidence.shape[1] - 1]) if span.is_over else None
    return Cause(tuple(order), float(time[result]), until, alive.excess)


def _onset(
    scores: LikelihoodRatios, at: int, number: int, first: int, time: Float[np.ndarray, " samples"]
) -> tuple[float, float, float]:
    """The time of an onset with its band, for the number of the first sample that shows it: it was
    after the sample before."""
    earliest = min(int(np.asarray(scores.earliest)[at, number]), first)
    latest = max(int(np.asarray(scores.latest)[at, number]), first)
    return float(time[first] + time[first - 1]) / 2, float(time[earliest - 1]), float(time[latest])


def _probabilities(
    logs: Float[np.ndarray, "samples faults"],
) -> Float[np.ndarray, "samples answers"]:
    """The probabilities of the faults and, last, of no fault, from the logarithms of the odds
    against no fault."""
    both = np.concatenate([logs, np.zeros((len(logs), 1))], axis=1)
    return np.exp(both - np.logaddexp.reduce(both, axis=1, keepdims=True))
