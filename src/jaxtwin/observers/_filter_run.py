"""Runs a filter over the samples of a recording, or step by step beside a rig."""

from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._jax_settings import own_settings
from .._padded_rows import first_rows, padded, padded_rows
from ..io import Experiment
from ..simulation import input_levels
from ._augmented_model import Transition
from ._estimates import Moments, moments
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._moving_horizon import MovingHorizonEstimator, MovingHorizonState
from ._observer import AbstractObserver

# The number of samples for which a program is compiled at least.
MIN_SAMPLES = 64

# A time between two samples that is longer than this many longest steps is a gap.
GAP_STEPS = 1.5


class FilterSamples(NamedTuple):
    """What a filter gets at each sample, or at a time in a gap between two of them.

    - `dt`: the time since the sample before, s; 0 for the first.
    - `duty`: the command since the sample before.
    - `readings`: NaN where there is none. `ambient`: NaN where it is not measured. degC.
    - `levels`: the rig's other inputs since the sample before; None for those of the rig file.
    """

    dt: Float[np.ndarray | Array, " samples"]
    duty: Float[np.ndarray | Array, "samples cells"]
    readings: Float[np.ndarray | Array, "samples channels"]
    ambient: Float[np.ndarray | Array, " samples"]
    levels: Float[np.ndarray | Array, "samples inputs"] | None = None

    def padded(self) -> "FilterSamples":
        """The samples, and further ones at the time of the last, without readings. Recordings of
        similar lengths then share a compiled program."""
        levels = self.levels
        return FilterSamples(
            dt=padded(np.asarray(self.dt), 0.0, MIN_SAMPLES),
            duty=padded(np.asarray(self.duty), least=MIN_SAMPLES),
            readings=padded(np.asarray(self.readings), np.nan, MIN_SAMPLES),
            ambient=padded(np.asarray(self.ambient), np.nan, MIN_SAMPLES),
            levels=None if levels is None else padded(np.asarray(levels), least=MIN_SAMPLES),
        )

    def __repr__(self) -> str:
        return f"<FilterSamples: {len(self.dt)}>"


class Filtered(NamedTuple):
    """The states after each sample, and what was expected of its readings.

    - `expected`, `covariance`: the mean and the covariance of the readings beforehand.
    """

    states: KalmanState
    expected: Float[Array | np.ndarray, "samples channels"]
    covariance: Float[Array | np.ndarray, "samples channels channels"]

    def __repr__(self) -> str:
        return f"<Filtered: {self.expected.shape[0]} samples of {self.expected.shape[1]} channels>"


def samples_of(
    kalman: ExtendedKalmanFilter, experiment: Experiment
) -> tuple[FilterSamples, Bool[np.ndarray, " samples"]]:
    """The samples of a recording with further ones, without readings, in its gaps; and which of
    them are those of the recording.

    **Raises:** `SimulationError` if the recording lacks a column for one of the rig's inputs.
    """
    levels = input_levels(experiment, kalman.model.twin.rig.inputs)
    time = experiment.time
    steps = np.diff(experiment.elapsed)
    parts = _parts(steps, kalman.longest_seconds)
    of = np.repeat(np.arange(len(steps)), parts)
    last = np.cumsum(parts)
    is_sample = np.zeros(1 + len(of), bool)
    is_sample[[0, *last]] = True
    duty = np.asarray(experiment.duty, float)
    ambient = np.full(len(time), np.nan)
    if experiment.ambient is not None:
        ambient = np.broadcast_to(np.asarray(experiment.ambient, float), time.shape)
    temperatures = experiment.temperatures
    assert temperatures is not None
    readings = np.full((len(is_sample), temperatures.shape[1]), np.nan)
    readings[is_sample] = temperatures
    samples = FilterSamples(
        dt=np.append(0.0, (steps / parts)[of]),
        duty=np.concatenate([duty[:1], duty[of]]),
        readings=readings,
        ambient=ambient[np.append(0, of + (is_sample[1:]))],
        levels=None if levels is None else levels[np.append(0, of)],
    )
    return samples, is_sample


def _parts(steps: Float[np.ndarray, "*steps"], longest: float) -> Int[np.ndarray, "*steps"]:
    """The number of steps of a filter in each time between two samples."""
    return np.where(steps > GAP_STEPS * longest, np.ceil(steps / longest - 1e-9), 1).astype(int)


def following(
    kalman: ExtendedKalmanFilter, start: KalmanState, samples: FilterSamples
) -> tuple[Filtered, Transition]:
    """Filters all samples, as a function that can be differentiated; and the steps to each."""

    @jax.checkpoint
    def take(
        state: KalmanState, sample: FilterSamples
    ) -> tuple[KalmanState, tuple[Filtered, Transition]]:
        state, step = kalman.linearised_step(state, sample.duty, sample.dt, sample.levels)
        expected = kalman.readings(state, sample.ambient)
        covariance = kalman.reading_covariance(state)
        state = kalman.update(state, sample.readings, jnp.isfinite(sample.readings), sample.ambient)
        return state, (Filtered(state, expected, covariance), step)

    return jax.lax.scan(take, start, samples)[1]


def filtered(kalman: ExtendedKalmanFilter, start: KalmanState, samples: FilterSamples) -> Filtered:
    """Filters all samples, as a program of its own."""
    return first_rows(_filtered(kalman, start, samples.padded()), len(samples.dt))


def estimated(
    estimator: MovingHorizonEstimator,
    reading: Float[np.ndarray, ""],
    duty: Float[np.ndarray, " cells"],
    samples: FilterSamples,
) -> Filtered:
    """The latest states of a moving-horizon estimator after all samples, from a first reading,
    degC, with a duty that the driver has reached."""
    return first_rows(_estimated(estimator, reading, duty, samples.padded()), len(samples.dt))


@persistent_jit
def _filtered(kalman: ExtendedKalmanFilter, start: KalmanState, samples: FilterSamples) -> Filtered:
    return following(kalman, start, samples)[0]


@persistent_jit
def _estimated(
    estimator: MovingHorizonEstimator,
    reading: Float[Array | np.ndarray, ""],
    duty: Float[Array | np.ndarray, " cells"],
    samples: FilterSamples,
) -> Filtered:
    def take(
        state: MovingHorizonState, sample: FilterSamples
    ) -> tuple[MovingHorizonState, Filtered]:
        state = estimator.step(state, sample.duty, sample.dt, sample.levels)
        expected = estimator.readings(state, sample.ambient)
        covariance = estimator.kalman.reading_covariance(state.latest)
        state = estimator.update(
            state, sample.readings, jnp.isfinite(sample.readings), sample.ambient
        )
        return state, Filtered(state.latest, expected, covariance)

    return jax.lax.scan(take, estimator.init(reading, duty), samples)[1]


def samples_between(
    duty: Float[np.ndarray, "times cells"],
    step: float,
    channels: int,
    kalman: ExtendedKalmanFilter,
    levels: Float[np.ndarray, "times inputs"] | None = None,
) -> FilterSamples:
    """Times without readings, each a step after the one before; a step is divided into as many
    parts as the filter needs."""
    parts = int(_parts(np.asarray(step), kalman.longest_seconds))
    commands = np.repeat(duty, parts, axis=0)
    count = len(commands)
    return FilterSamples(
        dt=np.full(count, step * len(duty) / count),
        duty=commands,
        readings=np.full((count, channels), np.nan),
        ambient=np.full(count, np.nan),
        levels=None if levels is None else np.repeat(levels, parts, axis=0),
    )


def moments_of(kalman: ExtendedKalmanFilter, states: KalmanState) -> Moments:
    """The moments of each state."""
    return first_rows(_moments_of(kalman, padded_rows(states, MIN_SAMPLES)), len(states.mean))


@persistent_jit_unoptimised
def _moments_of(kalman: ExtendedKalmanFilter, states: KalmanState) -> Moments:
    of_one = partial(moments, kalman.model)
    return jax.vmap(of_one)(states.mean, states.covariance)


def state_moments(kalman: ExtendedKalmanFilter, state: KalmanState) -> Moments:
    """The moments of a single state, in NumPy."""
    with own_settings():
        several = _moments_of(kalman, jax.tree.map(lambda leaf: np.asarray(leaf)[None], state))
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], several)


# The steps of an observer as programs, for what takes them one by one in Python: the twin beside a
# rig, and a virtual rig.

State = TypeVar("State")


@persistent_jit_unoptimised
def started(
    observer: AbstractObserver[State],
    nodes: Float[ArrayLike, "..."] | None,
    duty: Float[ArrayLike, " cells"],
) -> State:
    """The state at the start; see `AbstractObserver.init`."""
    return observer.init(nodes, duty)


@persistent_jit
def predicted(
    observer: AbstractObserver[State],
    state: State,
    duty: Float[ArrayLike, " cells"],
    ambient: Float[ArrayLike, ""],
    dt: Float[ArrayLike, ""],
) -> tuple[State, Float[Array, " channels"]]:
    """The state after a time, and the readings that it lets expect, in one call, because most of
    the time of a call is spent in Python."""
    state = observer.predict(state, duty, ambient, dt)
    return state, observer.readings(state, ambient)


@persistent_jit
def followed(
    observer: AbstractObserver[State],
    state: State,
    duty: Float[ArrayLike, " cells"],
    ambient: Float[ArrayLike, ""],
    dt: Float[ArrayLike, ""],
    readings: Float[ArrayLike, " channels"],
    mask: Bool[ArrayLike, " channels"],
) -> tuple[State, Float[Array, " channels"]]:
    """The state after a time and the readings at its end, and what was expected of them before, in
    one call too."""
    state = observer.predict(state, duty, ambient, dt)
    expected = observer.readings(state, ambient)
    return observer.update(state, readings, mask, ambient), expected
