"""The faults that explain a change best, each followed by a filter of its own."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.special import log_ndtr

from .._jax_settings import own_settings
from .._statistics import QUANTILE_975
from ..observers import Observed
from ._hypotheses import Hypotheses, Tracked, tracked
from ._likelihood_ratio import LikelihoodRatios, Prior
from ._recorded import filled_up
from ._signatures import suspected
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
NEGLIGIBLE_LOG_LIKELIHOOD = 10.0

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

    - `numbers`: those of the suspects; one may be there several times. `sized`: these suspects with
      the sizes for which their filters were made.
    - `first`: the number of the first sample that they followed. `onset`: that of the first sample
      with each fault.
    - `evidence`: the logarithm of the ratio of the likelihoods with and without each fault after
      each sample, until the one at which it was largest.
    - `multiple`, `spread`: of the fault at the end, and its standard deviation.
    - `excess`: how much larger the mean square of the innovations of the best is than it should be.
      Where even the best explains the readings badly, evidence and sizes are less certain by it.
    - `unexplained`: the part of the squares of the innovations beyond noise that the best leaves.
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
    unexplained: float
    scatter: Float[np.ndarray, " samples"]

    def size(self, place: int) -> tuple[float, float, float]:
        """The size of a fault, and its 95 % band."""
        suspect, middle = self.sized[place], float(self.multiple[place])
        half = QUANTILE_975 * float(self.spread[place])
        one_end, other = suspect.size_of(middle - half), suspect.size_of(middle + half)
        return suspect.size_of(middle), min(one_end, other), max(one_end, other)


def track_candidates(
    observed: Observed,
    suspects: Sequence[Suspect],
    prior: Prior,
    scores: LikelihoodRatios,
    log_odds: Float[np.ndarray, "samples faults_and_other"],
    at: int,
    last: int,
    is_over: bool,
) -> Survivors:
    """Follows the faults that explain a change best.

    **Arguments:**

    - `scores`: the likelihood ratios. `log_odds`: the logarithms of the odds that follow from them.
    - `at`: the sample at which these are largest. `last`: the last one that is followed.
    - `is_over`: whether the fault ended before that.
    """
    # A stuck channel is a candidate although the likelihood ratio has passed over its onset.
    stuck = _stuck(observed, suspects, at)
    order = [number for number in np.argsort(-log_odds[at, :-1]).tolist() if number not in stuck]
    # Few suspects are repeated.
    numbers = np.resize([*stuck, *order][:SURVIVORS], SURVIVORS)
    onset = np.asarray(scores.onset)[at, numbers]
    onset = np.array([stuck.get(n, first) for n, first in zip(numbers, onset, strict=True)])
    inflation = np.asarray(prior.inflation)[numbers]
    followed = [suspects[int(number)] for number in numbers]
    multiples = np.asarray(scores.multiple)[at, numbers]
    sized = [
        _of_multiple(suspect, float(multiple))
        for suspect, multiple in zip(followed, multiples, strict=True)
    ]
    turn = 0
    while True:
        turn += 1
        rows = slice(int(onset.min()) - 1, last + 1)
        # The ratio, which is linear in the fault, sees a large one a sample late.
        begins = np.concatenate([onset, onset - 1])
        effects = [
            abs(suspect.multiple_of(now.size)) for suspect, now in zip(followed, sized, strict=True)
        ]
        spread = np.tile(np.asarray(prior.spread)[numbers] / effects, 2)
        candidates = _follow(observed, 2 * sized, spread, begins, rows)
        evidences = (
            _evidence(observed, 2 * sized, candidates, begins, rows)
            / np.tile(inflation, 2)[:, None]
        )
        # Most is known when the fault ends: what comes after it speaks against it.
        last_kept = int(evidences.max(axis=0).argmax()) if is_over else evidences.shape[1] - 1
        is_earlier = evidences[SURVIVORS:, last_kept] > evidences[:SURVIVORS, last_kept]
        picked = np.arange(SURVIVORS) + SURVIVORS * is_earlier
        onset, evidence = begins[picked], evidences[picked, : last_kept + 1]
        at_end = jax.tree.map(lambda leaf, now=(picked, last_kept): leaf[now], candidates)
        is_alive = evidence[:, -1] > evidence[:, -1].max() - NEGLIGIBLE_LOG_LIKELIHOOD
        is_done = (np.abs(at_end.multiple - 1) < REFILTER_FRACTION) & ~is_earlier
        if (is_done | ~is_alive).all() or turn == MAX_ROUNDS:
            break
        sized = [
            _of_multiple(suspect, float(multiple)) if is_kept else suspect
            for suspect, multiple, is_kept in zip(sized, at_end.multiple, is_alive, strict=True)
        ]
    best = int(evidence[:, -1].argmax())
    excess = max(1.0, float(at_end.misfit[best] / inflation[best]))
    variance, scatter = _scatter(
        observed, int(onset[best]), slice(rows.start, rows.start + last_kept + 1), inflation[best]
    )
    unexplained = (excess - 1) / max(variance - 1, excess - 1, 1e-9)
    return Survivors(
        numbers, tuple(sized), rows.start, onset, evidence, at_end.multiple,
        at_end.spread * np.sqrt(inflation * excess), excess, unexplained, scatter,
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


def _stuck(observed: Observed, suspects: Sequence[Suspect], at: int) -> dict[int, int]:
    """The suspects that are stuck channels whose readings are the same for some time up to a
    sample, and the number of the second of these samples."""
    readings = np.asarray(observed.samples.readings)[: at + 1]
    result = {}
    for number, suspect in enumerate(suspects):
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
    at_end: Tracked,
    onset: Int[np.ndarray, " candidates"],
    rows: slice,
) -> Float[np.ndarray, "candidates samples"]:
    """The logarithm of the ratio of the likelihoods with each fault and without any, from its onset
    to each sample."""
    without = np.asarray(observed.filtered.states.log_likelihood)[rows]
    place = np.arange(len(without)) + rows.start
    since = np.where(place >= onset[:, None], without, 0.0).cumsum(axis=1)
    gained = at_end.log_likelihood - since
    one_sided = np.array([suspect.is_one_sided for suspect in sized])[:, None]
    above = log_ndtr(at_end.multiple / at_end.spread) + math.log(2.0)
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
