"""Diagnoses a recording: the observer runs once, and what explains its innovations is named."""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import log_ndtr, logsumexp

from .._arguments import of_kind
from .._errors import ObserverError
from .._jax_settings import own_settings
from .._normal_distribution import QUANTILE_975
from ..io import Experiment
from ..matching import Fit
from ..monitoring._monitor import SETTLE
from ..monitoring._thresholds import DAY
from ..observers import KalmanState, Observed, ProcessNoise, observe
from ..observers._filter_run import Samples
from ..physics import Twin
from ._diagnosis import HEALTHY, OTHER, Cause, Diagnosis, Explanation
from ._hypotheses import Hypotheses, Tracked, tracked
from ._likelihood_ratio import Inputs, Judged, Prior, healthy_squares, ratios
from ._signatures import Suspected, suspected
from ._suspects import Faults, Suspect, chosen

SPREAD = 1.5
"""The standard deviation of the size of a fault beforehand, in multiples of its usual effect."""

EVERY = 30 * DAY
"""The mean time between two faults, s, as between two false alarms of a monitor."""

SURE = math.log(19.0)
"""Logarithm of the odds from which on something has changed: 95 %."""

OVER = 10.0
"""A fault is over when so much of the logarithm of its odds is lost, and a tenth of it."""

AFTER = 30
"""A fault that is over is followed for so many samples more, to see when it ended."""

SURVIVORS = 6
"""The number of faults that are followed by filters of their own."""

BLOCK = 256
"""Recordings are filled up to multiples of so many samples, so that they share programs."""

CLOSE = 0.25
"""A size that differs from that of its filter by less than this part needs no other filter."""

ROUNDS = 3
"""The largest number of times that the filters of the survivors run."""

STRIDE = 12
"""In healthy recordings every so many samples begin a candidate, so that some become old."""

MOST = 8
"""The largest number of causes in a recording."""


def diagnose(
    fit: Twin | Fit,
    experiment: Experiment,
    faults: Faults = None,
    noise: ProcessNoise | None = None,
    *,
    healthy: Sequence[Experiment] | None = None,
) -> Diagnosis:
    """Finds which fault explains what changes in a recording, from when on and how large it is.

    `jaxtwin.diagnosis` describes how. A fault that was there in the first two minutes is part of
    what the observer takes for the rig.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `experiment`: the recording.
    - `faults`: what is looked for: names of `jaxtwin.diagnosis.suspects(twin)`; a `Suspect`; or
      functions `System -> System` by their names, `{"lid": function}`, whose size is the multiple
      of what they change. None for all usual suspects.
    - `noise`: the levels of the noise, as for `jaxtwin.observe`.
    - `healthy`: recordings in which nothing happened, from which follows how much more the
      innovations say than they should. None: those of a fit that was saved with them.

    **Raises:** the errors of `jaxtwin.observe`; `ObserverError` if the recording is too short, if
    the noise is no `ProcessNoise`, for an unknown fault, or for one that changes the nodes.
    """
    of_kind("diagnose: experiment", experiment, Experiment, "an Experiment", ObserverError)
    if noise is not None:
        expected = "a ProcessNoise, as jaxtwin.estimate_noise finds it"
        of_kind("diagnose: noise", noise, ProcessNoise, expected, ObserverError)
    if experiment.duration < 2 * SETTLE:
        raise ObserverError(
            f"{experiment.name or 'experiment'}: expected a recording of at least {2 * SETTLE:g} "
            f"s, in which an observer settles, got {experiment.duration:g} s"
        )
    observed = observe(fit, experiment, noise)
    model = observed.observer.model
    several = chosen(model.twin, faults, observed.channels)
    arrays = suspected(model, several)
    if healthy is None:
        is_there = isinstance(fit, Fit) and fit.comparisons is not None
        healthy = fit.experiments if is_there else ()  # pyright: ignore
    prior = learned(several, [observe(fit, one, noise) for one in healthy])
    return diagnosed(observed, several, arrays, prior)


def learned(several: Sequence[Suspect], healthy: Sequence[Observed]) -> Prior:
    """What is known beforehand of suspects, with the variance of their statistics in healthy
    recordings."""
    prior = Prior(
        np.full(len(several), SPREAD),
        np.array([one.is_one_sided for one in several]),
        np.ones(len(several) + 1),
    )
    squares, counts = np.zeros(len(several) + 1), np.zeros(len(several) + 1)
    for one in healthy:
        inputs = inputs_of(one, 0)
        is_turn = np.arange(len(inputs.begins)) % STRIDE == 0
        inputs = inputs._replace(begins=np.asarray(inputs.begins) & is_turn)
        with own_settings():
            own = suspected(one.observer.model, several)
            found = healthy_squares(one.observer, own, prior, inputs)
        squares, counts = squares + np.asarray(found[0]), counts + np.asarray(found[1])
    inflation = np.maximum(squares / np.maximum(counts, 1.0), 1.0)
    return prior._replace(inflation=np.where(counts > 0, inflation, 1.0))


def diagnosed(
    observed: Observed, several: Sequence[Suspect], arrays: Suspected, prior: Prior
) -> Diagnosis:
    """Diagnoses an observed recording."""
    time = observed.experiment.time[0] + np.cumsum(observed.samples.dt)
    start = int(np.searchsorted(time, time[0] + SETTLE))
    rate = np.median(np.diff(observed.time)) / EVERY / (len(several) + 1)
    answers = np.zeros((len(time), len(several) + 2))
    answers[:, -1] = 1.0
    causes: list[Cause] = []
    while start < len(time) and len(causes) < MOST:
        inputs = inputs_of(observed, start)
        with own_settings():
            found = ratios(observed.observer, arrays, prior, inputs)
        said = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(time)], found)
        logs = np.asarray(said.evidence) + math.log(rate)
        span = _episode(logs, start)
        end = len(time) if span is None else span.end
        answers[start:end] = _probabilities(logs[start:end])
        if span is None:
            break
        cause, rows, posterior = _judge(
            observed, several, prior, said, logs, span, time, math.log(rate)
        )
        answers[rows] = posterior
        causes.append(cause)
        start = int(np.searchsorted(time, time[min(end, len(time) - 1)] + SETTLE))
    names = (*(one.name for one in several), OTHER, HEALTHY)
    return Diagnosis(
        observed, tuple(several), tuple(causes), names, answers[np.asarray(observed.is_sample)]
    )


@dataclasses.dataclass(frozen=True)
class _Span:
    """The samples at which something was found, at which most was known of it, and after it was
    over; and whether it is over."""

    found: int
    best: int
    end: int
    is_over: bool


def _episode(logs: Float[np.ndarray, "samples faults"], start: int) -> _Span | None:
    """The first change; None for none."""
    total = logsumexp(logs, axis=1)
    above = np.flatnonzero(total[start:] > SURE)
    if not len(above):
        return None
    found = start + int(above[0])
    peaks = np.maximum.accumulate(total[found:])
    lost = np.flatnonzero(total[found:] < peaks - OVER - 0.1 * peaks)
    end = found + int(lost[0]) if len(lost) else len(total)
    best = found + int(np.argmax(total[found:end]))
    return _Span(found, best, end, bool(len(lost)))


def _judge(
    observed: Observed,
    several: Sequence[Suspect],
    prior: Prior,
    said: Judged,
    logs: Float[np.ndarray, "samples faults"],
    span: _Span,
    time: Float[np.ndarray, " samples"],
    rate: float,
) -> tuple[Cause, slice, Float[np.ndarray, "samples answers"]]:
    """The cause of a change, and the probabilities from its onset on, by filters of the faults that
    explain it best."""
    at, other = span.best, len(several)
    last = min(span.end + AFTER, len(time)) - 1 if span.is_over else at
    numbers = np.argsort(-logs[at, :other])[:SURVIVORS]
    numbers = np.resize(numbers, SURVIVORS)  # the same number for a short list of suspects
    own = [several[number] for number in numbers]
    now = [
        dataclasses.replace(one, size=_size(one, float(said.multiple[at, number])))
        for one, number in zip(own, numbers, strict=True)
    ]
    onset = np.asarray(said.onset)[at, numbers]
    for turn in range(ROUNDS):
        rows = slice(int(onset.min()) - 1, last + 1)
        # The ratio, which is linear in the fault, sees a large one a sample late.
        begins = np.concatenate([onset, onset - 1])
        both = _follow(observed, 2 * own, 2 * now, begins, rows)
        inflation = np.asarray(prior.inflation)[np.tile(numbers, 2)]
        each = _evidence(observed, 2 * now, both, begins, rows) / inflation[:, None]
        # Most is known when the fault ends: what comes after it speaks against it.
        most = int(each.max(axis=0).argmax()) if span.is_over else -1
        is_earlier = each[SURVIVORS:, most] > each[:SURVIVORS, most]
        picked = np.arange(SURVIVORS) + SURVIVORS * is_earlier
        onset, marginal = begins[picked], each[picked]
        of_each = jax.tree.map(lambda leaf, rows=picked: leaf[rows], both)
        multiple = of_each.multiple[:, most]
        alive = marginal[:, most] > marginal[:, most].max() - 10
        is_done = (np.abs(multiple - 1) < CLOSE) & ~is_earlier
        if turn == ROUNDS - 1 or (is_done | ~alive).all():
            break
        now = [
            dataclasses.replace(one, size=_size(one, float(m))) if a else one
            for one, m, a in zip(now, multiple, alive, strict=True)
        ]
    onsets = np.asarray(said.evidence - said.ratio)[at] + rate
    # No suspect is better known than the best of them explains the readings.
    best = int(marginal[:, most].argmax())
    excess = max(1.0, float(of_each.misfit[best, most] / inflation[best]))
    if span.is_over:
        rows = slice(rows.start, rows.start + most + 1)
    table = np.full((rows.stop - rows.start, other + 1), -math.inf)
    table[:, numbers] = (marginal / excess + onsets[numbers][:, None]).T[: len(table)]
    table[:, other] = (logs[rows, other] - rate) / excess + rate
    posterior = _probabilities(table)
    explained = []
    for place, number in enumerate(numbers):
        if number in numbers[:place]:
            continue
        one, m, s = now[place], of_each.multiple[place, most], of_each.spread[place, most]
        s = s * math.sqrt(float(inflation[place]) * excess)
        ends = [one.size_of(float(m + sign * QUANTILE_975 * s)) for sign in (-1, 1)]
        explained.append(_explanation(
            one.name, float(posterior[-1, number]), (one.size_of(float(m)), *sorted(ends), one.none),
            one.unit, said, at, int(number), time, int(onset[place]),
        ))  # fmt: skip
    nothing = (math.nan,) * 4
    explained.append(
        _explanation(
            OTHER,
            float(posterior[-1, other]),
            nothing,
            "",
            said,
            at,
            other,
            time,
            int(np.asarray(said.onset)[at, other]),
        )
    )
    explained.sort(key=lambda one: -one.probability)
    begin = int(onset[np.argmax(posterior[-1, numbers])])
    until = float(time[rows.stop - 1]) if span.is_over else None
    above = logsumexp(logs[begin : at + 1], axis=1) > SURE
    found = begin + int(above.argmax()) if above.any() else span.found
    return Cause(tuple(explained), float(time[found]), until), rows, posterior


def _follow(
    observed: Observed,
    own: Sequence[Suspect],
    now: Sequence[Suspect],
    onset: Int[np.ndarray, " survivors"],
    rows: slice,
) -> Tracked:
    """Runs the filters of some suspects over some samples."""
    model = observed.observer.model
    arrays = suspected(model, now)
    multiples = [_multiple(before, one.size) for before, one in zip(own, now, strict=True)]
    with own_settings():
        readings = np.nan_to_num(np.asarray(model.from_degC(observed.samples.readings)))
    hypotheses = Hypotheses(
        arrays,
        onset,
        readings[onset],
        SPREAD / np.abs(multiples),
        np.array([0.0 if one.is_one_sided else -10.0 for one in now]),
        np.array([min(one.largest, 50.0) for one in now]),
    )
    length = 2 ** max(7, math.ceil(math.log2(rows.stop - rows.start)))
    befores, samples = _filled(observed, rows.start, length)
    numbers = rows.start + np.arange(length)
    with own_settings():
        found = tracked(observed.observer, hypotheses, numbers, befores, samples)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:, : rows.stop - rows.start], found)


def _evidence(
    observed: Observed,
    now: Sequence[Suspect],
    of_each: Tracked,
    onset: Int[np.ndarray, " survivors"],
    rows: slice,
) -> Float[np.ndarray, "survivors samples"]:
    """The logarithm of the ratio of the likelihoods with each fault and without any, from its onset
    to each sample."""
    without = np.asarray(observed.filtered.states.log_likelihood)[rows]
    place = np.arange(len(without)) + rows.start
    since = np.where(place >= onset[:, None], without, 0.0).cumsum(axis=1)
    gained = of_each.log_likelihood - since
    one_sided = np.array([one.is_one_sided for one in now])[:, None]
    above = log_ndtr(of_each.multiple / of_each.spread) + math.log(2.0)
    gained = gained + np.where(one_sided, above, 0.0)
    return np.where(place >= onset[:, None], gained, 0.0)


def _explanation(
    name: str,
    probability: float,
    size: tuple[float, ...],
    unit: str,
    said: Judged,
    at: int,
    number: int,
    time: Float[np.ndarray, " samples"],
    first: int,
) -> Explanation:
    """An explanation whose first sample is given. The fault began after the sample before."""
    earliest = min(int(np.asarray(said.earliest)[at, number]), first)
    latest = max(int(np.asarray(said.latest)[at, number]), first)
    begin = float(time[first] + time[first - 1]) / 2
    return Explanation(
        name, probability, *size, unit, begin, float(time[earliest - 1]), float(time[latest])
    )


def _size(one: Suspect, multiple: float) -> float:
    """The size at which a filter of a suspect is made: within its bounds, and not 0."""
    least = 0.05 if one.is_one_sided else -math.inf
    limited = min(max(multiple, least), one.largest if one.unit == "share" else 0.98 * one.largest)
    if abs(limited) < 0.05:
        limited = 0.05
    return one.size_of(limited)


def _multiple(one: Suspect, size: float) -> float:
    """The multiple of the usual effect that has a size."""
    if one.is_reciprocal:
        return (1 / size - 1 / one.none) / (1 / one.size - 1 / one.none)
    return (size - one.none) / (one.size - one.none)


def _probabilities(
    logs: Float[np.ndarray, "samples faults"],
) -> Float[np.ndarray, "samples answers"]:
    """The probabilities of the faults and, last, of no fault, from the logarithms of the odds
    against no fault."""
    both = np.concatenate([logs, np.zeros((len(logs), 1))], axis=1)
    return np.exp(both - logsumexp(both, axis=1, keepdims=True))


def inputs_of(observed: Observed, start: int) -> Inputs:
    """The samples of a recording, from one of which on faults may begin."""
    count = len(observed.is_sample)
    length = BLOCK * math.ceil(count / BLOCK)
    befores, samples = _filled(observed, 0, length)
    begins: Bool[np.ndarray, " samples"] = np.zeros(length, bool)
    begins[:count] = np.asarray(observed.is_sample) & (np.arange(count) >= max(start, 1))
    return Inputs(befores, samples, begins)


def _filled(observed: Observed, first: int, length: int) -> tuple[KalmanState, Samples]:
    """So many samples from one on, with the states before each, filled up with samples of no length
    and without readings."""
    count = len(observed.is_sample)
    rows = np.minimum(np.arange(first, first + length), count - 1)
    befores = jax.tree.map(
        lambda leaf: np.asarray(leaf)[np.maximum(rows - 1, 0)], observed.filtered.states
    )
    is_there = np.arange(first, first + length) < count
    samples = observed.samples
    levels = None if samples.levels is None else np.asarray(samples.levels)[rows]
    filled = Samples(
        dt=np.where(is_there, np.asarray(samples.dt)[rows], 0.0),
        duty=np.asarray(samples.duty)[rows],
        readings=np.where(is_there[:, None], np.asarray(samples.readings)[rows], np.nan),
        ambient=np.where(is_there, np.asarray(samples.ambient)[rows], np.nan),
        levels=levels,
    )
    return befores, filled
