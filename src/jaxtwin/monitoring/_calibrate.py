"""The calibration of a monitor: what its statistics are on healthy recordings."""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .._arguments import finite_number, whole_number
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..errors import ObserverError
from ..io import Experiment, as_experiments
from ..matching import Fit, nominal_twin
from ..observers import (
    ExtendedKalmanFilter,
    FilterSamples,
    KalmanState,
    Observed,
    ProcessNoise,
    filtered,
    first_reading,
    observe,
    started,
    usual_noise,
)
from ..physics import Twin
from ._innovation_tests import CLIP
from ._monitor import SETTLE, Monitor, evidences_of
from ._response import Response, response_of
from ._state_test import parameters_of
from ._thresholds import (
    DAY,
    FAMILIES,
    MIN_EQUAL_READINGS,
    MonitorCalibration,
    Reference,
    Tail,
    nominal_calibration,
    usual_tails,
)

# Healthy recordings that the model of an observer makes: its twin, with all that the observer
# takes as uncertain drawn at random.


# The degrees of freedom of Student's distribution of the simulated noise of readings, whose
# kurtosis is infinite: that of real innovations is 5 to 100.
STUDENT_T_DEGREES_OF_FREEDOM = 4.0

# The largest multiple of a standard deviation that is drawn: the filter is linear about its twin,
# and a rig that is farther away is not healthy.
MAX_DRAW_SIGMAS = 2.5

# The mean time between two corrections of a camera without an interval, s.
CORRECTIONS = 160.0


def simulated(observed: Observed, seed: int) -> Observed:
    """An observed recording of which rig and readings are drawn anew.

    The values of the twin, the start, the room and the heats are drawn from the filter's
    distribution at the start, and noise from that of each step; duty and times are those of the
    recording.
    """
    kalman, samples, old = observed.observer, observed.samples, observed.experiment
    with own_settings():
        first = np.asarray(first_reading(old))
        start = started(kalman, first, np.zeros_like(samples.duty[0]))
        drawn = np.asarray(_drawn(kalman, start, samples, jax.random.key(seed)))
        readings = np.where(np.isfinite(samples.readings), drawn, np.nan)
        samples = samples._replace(readings=readings)
        run = filtered(kalman, start, samples)
    experiment = Experiment(
        old.time,
        old.duty,
        channels=old.channels,
        temperatures=readings[np.asarray(observed.is_sample)],
        ambient=old.ambient,
        inputs=old.inputs,
        name=old.name,
        group=old.group,
    )
    return dataclasses.replace(observed, experiment=experiment, samples=samples, filtered=run)


@persistent_jit
def _drawn(
    kalman: ExtendedKalmanFilter, start: KalmanState, samples: FilterSamples, key: PRNGKeyArray
) -> Float[Array, "samples channels"]:
    """Draws a rig and its readings."""
    model = kalman.model
    of_start, of_phase, of_steps = jax.random.split(key, 3)
    size = len(start.mean)
    parts, interval = len(model.relaxation), model.interval
    values, room = model.layout.of("values"), model.layout.of("room").start

    def drawn(mean: Array, covariance: Array, key: PRNGKeyArray) -> Array:
        variances, vectors = jnp.linalg.eigh(covariance)
        roots = jnp.sqrt(jnp.maximum(variances, 0.0))
        return mean + vectors @ (
            roots * jax.random.truncated_normal(key, -MAX_DRAW_SIGMAS, MAX_DRAW_SIGMAS, (size,))
        )

    def take(
        carry: tuple[KalmanState, Array], given: tuple[FilterSamples, Array]
    ) -> tuple[tuple[KalmanState, Array], Array]:
        (state, since), (sample, one) = carry, given
        of_noise, of_time, of_jump, of_reading = jax.random.split(one, 4)
        after, transition = kalman.linearised_step(state, sample.duty, sample.dt, sample.levels)
        mean = drawn(after.mean, transition.noise, of_noise)
        if parts:
            since = since + sample.dt
            if interval is None:
                is_corrected = jax.random.uniform(of_time) < sample.dt / CORRECTIONS
            else:
                is_corrected = since >= interval
                since = jnp.where(is_corrected, since - interval, since)
            jump = model.noise.jump_mean + model.noise.jump * jax.random.normal(of_jump, (parts,))
            mean = mean.at[model.layout.fading].add(jnp.where(is_corrected, jump, 0.0))
        # The values differ between rigs, and do not wander within one.
        mean = mean.at[values].set(state.mean[values])
        # A room that is measured is that of the recording.
        measured = model.from_degC(jnp.asarray(sample.ambient))
        mean = mean.at[room].set(jnp.where(jnp.isfinite(measured), measured, mean[room]))
        # A single rig is drawn: its covariance is of no use.
        after = eqx.tree_at(lambda s: (s.mean, s.covariance), after, (mean, state.covariance))
        heavy = jax.random.t(of_reading, STUDENT_T_DEGREES_OF_FREEDOM, (len(model.columns),))
        error = heavy * jnp.sqrt(
            (1 - 2 / STUDENT_T_DEGREES_OF_FREEDOM) * kalman.reading_variance(after)
        )
        return (after, since), kalman.readings(after, sample.ambient) + error

    # The filter does not know when the camera corrected itself last.
    since = (interval or 0.0) * jax.random.uniform(of_phase)
    begin = eqx.tree_at(lambda s: s.mean, start, drawn(start.mean, start.covariance, of_start))
    keys = jax.random.split(of_steps, len(samples.dt))
    return jax.lax.scan(take, (begin, since), (samples, keys))[1]


# The tail of a statistic of healthy rigs: from what is seen in hours to once in months.
#
# Peaks over a level $u$ that few blocks of a minute pass have an exponential tail, for
# cumulative sums exactly so in the limit (their run length grows by $e^{2kh}$): the logarithm
# of the mean time between two passages of $h$ is linear in $h$. The scale is the mean excess.
# Two levels are tried, which a fifth of the blocks and a hundred of them pass, and the one with
# the higher threshold counts: healthy rigs differ, so that the peaks of many hours are those of
# the rigs that differ most; and where simulations are calmer than a rig, their last peaks are
# too. How far the rate at a threshold may be off is found by drawing recordings, and in each
# the blocks, again.

# The length of a block, s, of which the largest value counts.
BLOCK_SECONDS = 60.0

# The part of the blocks that passes the lower level.
TAIL_FRACTION = 0.2

# The number of blocks that pass the higher level: the scale is then known to a tenth.
PEAK_BLOCKS = 100

# How often recordings are drawn again.
BOOTSTRAP_DRAWS = 200

# The smallest number of blocks from which a tail is estimated.
MIN_BLOCKS = 25


def block_maxima(
    time: Float[np.ndarray, " times"], statistic: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " blocks"]:
    """The largest values of the whole blocks of a recording."""
    number = ((time - time[0]) / BLOCK_SECONDS).astype(int)
    count = int((time[-1] - time[0]) / BLOCK_SECONDS)
    result = np.full(count + 1, -np.inf)
    np.maximum.at(result, np.minimum(number, count), statistic)
    return result[:count][np.isfinite(result[:count])]


def tail_of(
    maxima: Sequence[Float[np.ndarray, " blocks"]], source: str, month: float = 30 * DAY
) -> Tail | None:
    """The tail of a statistic from its block maxima in several recordings; None if there are too
    few blocks."""
    several = [values for values in maxima if len(values)]
    if sum(map(len, several)) < MIN_BLOCKS:
        return None
    blocks, seconds = np.concatenate(several), month * len(FAMILIES)
    tails = {
        passing: Tail(*_tail(blocks, passing), source, len(blocks) * BLOCK_SECONDS / 3600)
        for passing in (TAIL_FRACTION, min(TAIL_FRACTION, PEAK_BLOCKS / len(blocks)))
    }
    passing = max(tails, key=lambda fraction: tails[fraction].threshold(seconds))
    at = tails[passing].threshold(seconds)
    random = np.random.default_rng(0)
    logs = []
    for _ in range(BOOTSTRAP_DRAWS):
        drawn = [several[n] for n in random.integers(len(several), size=len(several))]
        again = np.concatenate(
            [values[random.integers(len(values), size=len(values))] for values in drawn]
        )
        logs.append(math.log(Tail(*_tail(again, passing)).seconds(at)))
    return tails[passing]._replace(spread=float(np.std(logs)))


def _tail(maxima: Float[np.ndarray, " blocks"], passing: float) -> tuple[float, float, float]:
    """The level that a part of the blocks passes, its rate and the scale."""
    level = float(np.quantile(maxima, 1 - passing))
    over = maxima[maxima > level] - level
    scale = max(float(over.mean()) if len(over) else 0.0, 1e-3 * max(abs(level), 1e-3))
    return level, passing / BLOCK_SECONDS, scale


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
    rig = nominal_twin("calibrate_monitor: fit", fit, ObserverError).rig
    several = as_experiments("calibrate_monitor: experiments", experiments, ObserverError, rig)
    budget = finite_number("calibrate_monitor: hours", hours, ObserverError)
    first = whole_number("calibrate_monitor: seed", seed, 0, ObserverError)
    levels = usual_noise(fit, several) if noise is None else noise
    observed = [observe(fit, recording, levels) for recording in several]
    longest = max(recording.experiment.duration for recording in observed)
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
        healthy = simulated(observed[number % len(observed)], seed + number)
        number, seconds = number + 1, seconds - healthy.experiment.duration
        yield healthy


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
    times = [np.diff(recording.time) for recording in observed]
    sample_time = float(np.median(np.concatenate(times)))
    names = sorted({name for recording in observed for name in recording.channels})
    scales, memory, still = {}, {}, {}
    for name in names:
        series = [_settled(recording, name) for recording in observed if name in recording.channels]
        scales[name], memory[name] = _scale_and_memory(series)
        longest = max((_longest_still(recording, name) for recording in observed), default=0)
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
    clipped = [np.clip(sery, -CLIP, CLIP) for sery in series]
    both = np.concatenate(clipped)
    both = both[np.isfinite(both)]
    if len(both) < 30:
        return 1.0, 0.0
    scale = math.sqrt(float(np.mean(both**2))) or 1.0
    pairs = np.concatenate([values[1:] * values[:-1] for values in clipped])
    pairs = pairs[np.isfinite(pairs)]
    memory = float(np.mean(pairs)) / scale**2 if len(pairs) else 0.0
    return scale, float(np.clip(memory, 0.0, 0.95))


def _longest_still(observed: Observed, channel: str) -> int:
    """The largest number of readings in sequence that each repeat the one before."""
    if channel not in observed.channels:
        return 0
    readings = np.asarray(observed.experiment.temperatures)[:, observed.channels.index(channel)]
    there = readings[np.isfinite(readings)]
    ends = np.flatnonzero(np.diff(there, prepend=np.nan, append=np.nan) != 0)
    return int(np.diff(ends).max(initial=1)) - 1


def _references(observed: Sequence[Observed]) -> dict[str, Reference]:
    """What the observer says of each parameter at the end of the recordings."""
    result: dict[str, list[float]] = {}
    for recording in observed:
        model = recording.observer.model
        if model.directions is None:
            continue
        change = np.asarray(recording.estimates.moments.values.mean)
        later = recording.time >= recording.time[0] + LAST * recording.experiment.duration
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
    for recording in observed:
        result = evidences_of(Monitor(recording.observer, plain, response, None), recording)
        later = recording.time >= recording.time[0] + SETTLE
        for family in FAMILIES:
            scores = getattr(result, family).score
            if scores.shape[1] and later.any():
                largest = scores[later].max(axis=1)
                maxima[family].append(block_maxima(recording.time[later], largest))
    tails = {family: tail_of(several, source) for family, several in maxima.items()}
    return {family: tail for family, tail in tails.items() if tail is not None}
