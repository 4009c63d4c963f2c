"""The calibration of a monitor: what its statistics are on healthy recordings."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, whole_number
from ..errors import ObserverError
from ..io import Experiment
from ..io._experiment import as_experiments
from ..matching import Fit
from ..observers import Observed, ProcessNoise, observe
from ..observers._observe import usual_noise
from ..physics import Twin
from ._innovation_tests import CLIP
from ._monitor import SETTLE, Monitor
from ._response import Response, response_of
from ._run import evidences_of
from ._simulated import simulated
from ._state_test import parameters_of
from ._tails import block_maxima, tail_of
from ._thresholds import (
    FAMILIES,
    MIN_EQUAL_READINGS,
    MonitorCalibration,
    Reference,
    Tail,
    nominal_calibration,
    usual_tails,
)

# The part of a recording, at its end, over which the changes of parameters are averaged.
LAST = 0.5


def calibrate_monitor(
    fit: Twin | Fit,
    experiments: Experiment | Sequence[Experiment],
    noise: ProcessNoise | None = None,
    *,
    hours: float | int = 20.0,
    seed: int = 0,
) -> MonitorCalibration:
    """Finds what is healthy, from recordings and from simulations of the observer's model.

    Thresholds follow from the mean time between false alarms that `jaxtwin.monitor` is given.
    Statistics are looked at for hours, and their tails extrapolated (`jaxtwin.monitoring`), from
    the recordings and from the simulations, in which the twin, its start and its room are drawn
    anew for each run. The higher of the thresholds counts.

    **Arguments:**

    - `fit`: the fit or the twin.
    - `experiments`: healthy recordings, such as those of the match; those that are judged later
      must not be among them.
    - `noise`: the levels of the noise, as for `jaxtwin.observe`.
    - `hours`: how long the simulations are together, h; 0 for none.
    - `seed`: the seed of the simulations.

    **Raises:** the errors of `jaxtwin.observe`; `ObserverError` if all recordings are too short.
    """
    several = as_experiments("calibrate_monitor: experiments", experiments, ObserverError)
    budget = finite_number("calibrate_monitor: hours", hours, ObserverError)
    first = whole_number("calibrate_monitor: seed", seed, 0, ObserverError)
    levels = usual_noise(fit, several) if noise is None else noise
    observed = [observe(fit, one, levels) for one in several]
    longest = max(one.experiment.duration for one in observed)
    if longest < 2 * SETTLE:
        raise ObserverError(
            f"calibrate_monitor: experiments: expected a recording of at least {2 * SETTLE:g} s, "
            f"the longest has {longest:g}"
        )
    return calibration_of_recordings(observed, _simulations(observed, 3600 * budget, first))


def _simulations(
    observed: Sequence[Observed], seconds: float | int, seed: int
) -> Iterator[Observed]:
    """Simulations of recordings that last so long together, one at a time: an hour of a large rig
    takes 100 MB."""
    number = 0
    while seconds > 0:
        one = simulated(observed[number % len(observed)], seed + number)
        number, seconds = number + 1, seconds - one.experiment.duration
        yield one


def calibration_of_recordings(
    observed: Sequence[Observed], drawn: Iterable[Observed] = ()
) -> MonitorCalibration:
    """What observed recordings, and simulations of them, say of a healthy rig."""
    plain = _plain_calibration(observed)
    response = response_of(observed[0].observer)
    of_recordings = _tails(observed, plain, response, "recordings")
    of_simulations = _tails(drawn, plain, response, "simulations")
    tails = {
        family: tuple(
            tail
            for tail in (of_recordings.get(family), of_simulations.get(family))
            if tail is not None
        )
        for family in FAMILIES
    }
    return plain.with_tails(tails)


def usual_calibration(observed: Observed) -> MonitorCalibration:
    """What is usual, if no healthy recording is known."""
    return nominal_calibration(observed.channels, float(np.median(np.diff(observed.time))))


def _plain_calibration(observed: Sequence[Observed]) -> MonitorCalibration:
    """The scales, correlations and references of some recordings, with usual tails."""
    times = [np.diff(one.time) for one in observed]
    sample_time = float(np.median(np.concatenate(times)))
    names = sorted({name for one in observed for name in one.channels})
    scales, memory, still = {}, {}, {}
    for name in names:
        series = [_settled(one, name) for one in observed if name in one.channels]
        scales[name], memory[name] = _scale_and_memory(series)
        longest = max((_longest_still(one, name) for one in observed), default=0)
        still[name] = max(MIN_EQUAL_READINGS, 3.0 * longest)
    return MonitorCalibration(
        sample_time=sample_time,
        scales=scales,
        memory=memory,
        tails=usual_tails(sample_time),
        still=still,
        references=_references(observed),
    )


def _settled(observed: Observed, channel: str) -> Float[np.ndarray, " samples"]:
    """The standardised innovations of a channel after the start."""
    place = observed.channels.index(channel)
    later = observed.time >= observed.time[0] + SETTLE
    return observed.standardised[later, place]


def _scale_and_memory(series: Sequence[Float[np.ndarray, " samples"]]) -> tuple[float, float]:
    """The spread of clipped innovations, and the correlation of neighbours."""
    clipped = [np.clip(one, -CLIP, CLIP) for one in series]
    both = np.concatenate(clipped)
    both = both[np.isfinite(both)]
    if len(both) < 30:
        return 1.0, 0.0
    scale = math.sqrt(float(np.mean(both**2))) or 1.0
    pairs = np.concatenate([one[1:] * one[:-1] for one in clipped])
    pairs = pairs[np.isfinite(pairs)]
    memory = float(np.mean(pairs)) / scale**2 if len(pairs) else 0.0
    return scale, float(np.clip(memory, 0.0, 0.95))


def _longest_still(observed: Observed, channel: str) -> int:
    """The largest number of equal readings in sequence."""
    if channel not in observed.channels:
        return 0
    readings = np.asarray(observed.experiment.temperatures)[:, observed.channels.index(channel)]
    there = readings[np.isfinite(readings)]
    ends = np.flatnonzero(np.diff(there, prepend=np.nan, append=np.nan) != 0)
    return int(np.diff(ends).max(initial=1)) - 1


def _references(observed: Sequence[Observed]) -> dict[str, Reference]:
    """What the observer says of each parameter at the end of the recordings."""
    result: dict[str, list[float]] = {}
    for one in observed:
        model = one.observer.model
        if model.directions is None:
            continue
        change = np.asarray(one.estimates.moments.values.mean)
        later = one.time >= one.time[0] + LAST * one.experiment.duration
        for name, mean in zip(parameters_of(model), change[later].mean(axis=0), strict=True):
            result.setdefault(name, []).append(float(mean))
    return {
        name: Reference(
            float(np.mean(means)),
            float(np.std(means, ddof=1)) if len(means) > 1 else 0.0,
            len(means),
        )
        for name, means in result.items()
    }


def _tails(
    observed: Iterable[Observed], plain: MonitorCalibration, response: Response, source: str
) -> dict[str, Tail]:
    """The tails of all families in some recordings."""
    maxima: dict[str, list[np.ndarray]] = {family: [] for family in FAMILIES}
    for one in observed:
        result = evidences_of(Monitor(one.observer, plain, response, None), one)
        later = one.time >= one.time[0] + SETTLE
        for family in FAMILIES:
            scores = getattr(result, family).score
            if scores.shape[1] and later.any():
                largest = scores[later].max(axis=1)
                maxima[family].append(block_maxima(one.time[later], largest))
    tails = {family: tail_of(several, source) for family, several in maxima.items()}
    return {family: tail for family, tail in tails.items() if tail is not None}
