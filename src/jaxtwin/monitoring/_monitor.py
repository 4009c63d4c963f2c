"""The monitor of a rig: tests of what an observer says at each sample, one by one or of a
recording."""

import math
from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._padded_rows import first_rows, padded_rows
from ..observers import AugmentedModel, ExtendedKalmanFilter, Observed
from ._evidence import Evidence, Evidences, ObservedSample, observed_sample
from ._innovation_tests import RESET_SCORE, InnovationState, InnovationTests
from ._response import Response
from ._state_test import SlowState, StateTest, main_parameters, parameter_spreads, parameters_of
from ._thresholds import FAMILIES, MonitorCalibration, Reference

# Tests of single readings: of a channel that is frozen, of one that has gone to the room, and
# of one that was impossible for a moment.


# A reading must be at the room for this time, s.
GONE_SECONDS = 5.0

# A duty from which on a drive counts as saturated.
SATURATED_DUTY = 0.9

# A frozen reading must be expected to have moved by this multiple of the noise of a reading, or to
# be equal for three times as long.
MIN_EXPECTED_MOVE_SIGMAS = 4.0


@final
class ChannelState(eqx.Module):
    """What was read last, and for how long.

    - `reading`: the last readings. `equal`: how many of them in sequence were equal.
    - `still`: for how long, s. `moved`: how far they were expected to move meanwhile, K.
    - `driven`: for how long each cell has been saturated, up and down, s.
    - `at_room`: for how long each channel has been at the room meanwhile, s.
    - `rejected`: the innovation of the last reading if it was rejected, otherwise 0, K.
    - `since_rejected`: the time since the first of these, s.
    """

    reading: Float[Array, " channels"]
    equal: Float[Array, " channels"]
    still: Float[Array, " channels"]
    moved: Float[Array, " channels"]
    driven: Float[Array, "2 cells"]
    at_room: Float[Array, " channels"]
    rejected: Float[Array, " channels"]
    since_rejected: Float[Array, " channels"]


@final
class ChannelTests(eqx.Module):
    """The tests of single readings.

    - `response`: how a driven cell shows in the channels.
    - `still`: the number of equal readings in sequence that a healthy channel does not show.
    """

    model: AugmentedModel
    response: Response
    still: Float[np.ndarray | Array, " channels"]

    def init(self) -> ChannelState:
        """The state before the first sample."""
        none = jnp.zeros(len(self.still))
        driven = jnp.zeros((2, self.model.layout.heats))
        return ChannelState(
            jnp.full_like(none, jnp.nan), none, none, none, driven, none, none, none
        )

    def step(
        self, state: ChannelState, sample: ObservedSample, dt: Float[Array, ""]
    ) -> tuple[ChannelState, tuple[Evidence, Evidence, Evidence]]:
        """The state after a sample, and what it says of frozen, gone and impossible channels."""
        readings = jnp.asarray(sample.readings)
        there = jnp.isfinite(readings)
        # A missing reading says nothing; another one ends the sequence.
        equal = there & (readings == state.reading)
        goes_on = equal | ~there
        count = jnp.where(goes_on, state.equal + equal, 0.0)
        still = jnp.where(goes_on, state.still + dt, 0.0)
        moved = jnp.where(goes_on, state.moved + jnp.abs(jnp.asarray(sample.slope)) * dt, 0.0)
        enough = jnp.clip(moved / (MIN_EXPECTED_MOVE_SIGMAS * self.model.noise.reading), 1 / 3, 1.0)
        frozen = Evidence(count / self.still * enough, still, moved)

        duty = jnp.asarray(sample.duty)
        saturated = jnp.stack([duty, -duty]) >= SATURATED_DUTY
        driven = jnp.where(saturated, state.driven + dt, 0.0)
        shows = (driven[:, :, None] >= jnp.asarray(self.response.seconds)).any(axis=(0, 1))
        measured = jnp.asarray(sample.ambient)
        stated = self.model.stepper.reference - ZERO_CELSIUS
        away = readings - jnp.where(jnp.isfinite(measured), measured, stated)
        is_near = jnp.abs(away) <= jnp.asarray(self.response.near)
        at_room = jnp.where(shows & is_near, state.at_room + dt, 0.0)
        at_room = jnp.where(there, at_room, state.at_room)
        gone = Evidence(at_room / GONE_SECONDS, at_room, jnp.where(there, away, 0.0))
        reading = jnp.where(there, readings, state.reading)

        rejected = jnp.asarray(sample.rejected)
        since = state.since_rejected + dt
        # What lasts is followed after some samples, and then is far from what is expected.
        is_back = there & (state.rejected != 0) & jnp.asarray(sample.is_inside)
        impossible = Evidence(is_back.astype(since.dtype), since, state.rejected)
        since = jnp.where(state.rejected != 0, since, 0.0)
        rejected = jnp.where(there | (rejected != 0), rejected, state.rejected)
        return (
            ChannelState(reading, count, still, moved, driven, at_room, rejected, since),
            (frozen, gone, impossible),
        )


# Parameters are averaged over this time before they are compared with those of the match, s.
AVERAGING_SECONDS = 600.0

# A change of a parameter must last for this time, s.
PERSISTENT = 600.0

# The probability that a recording of a healthy rig is called changed.
LEVEL = 0.05


@final
class ShiftState(eqx.Module):
    """The averaged changes of the parameters, and for how long each has been unlike those of the
    match, s. `began`: whether the average has begun."""

    averages: Float[Array, " parameters"]
    shifted: Float[Array, " parameters"]
    began: Bool[Array, ""]


@final
class ShiftTest(eqx.Module):
    """Compares the averaged parameters with what the observer said of the matched recordings.

    Those that the noise names as drifting are compared; if there is none, all of them are. The
    difference that counts follows from Student's distribution with the spread between the matched
    recordings, or, if they are too few, from what the fit does not know of the parameter.

    - `matched`: the mean in the matched recordings. `unlike`: the difference from it that counts.
    - `freedom`: the degrees of freedom of the spread.
    """

    model: AugmentedModel
    matched: Float[np.ndarray | Array, " parameters"]
    unlike: Float[np.ndarray | Array, " parameters"]
    freedom: Float[np.ndarray | Array, " parameters"]

    def __init__(self, model: AugmentedModel, references: Mapping[str, Reference]):
        from scipy.special import stdtrit  # a part of scipy.stats, which takes a second to import

        names = parameters_of(model)
        compared = [name for name in names if name in model.noise.names] or list(names)
        spreads = parameter_spreads(model)
        self.model = model
        self.matched = np.zeros(len(names))
        self.unlike = np.full(len(names), math.inf)
        self.freedom = np.full(len(names), math.inf)
        for place, name in enumerate(names):
            if name not in compared:
                continue
            known, spread = references.get(name), spreads[place]
            if known is not None:
                self.matched[place] = known.mean
                if known.recordings > 1 and known.spread > 0:
                    spread = known.spread * math.sqrt(1 + 1 / known.recordings)
                    self.freedom[place] = known.recordings - 1
            chance = LEVEL / len(compared) / 2
            self.unlike[place] = spread * -float(stdtrit(self.freedom[place], chance))

    def init(self) -> ShiftState:
        """The state before the first sample."""
        none = jnp.zeros(len(self.matched))
        return ShiftState(none, none, jnp.zeros((), bool))

    def step(
        self,
        state: ShiftState,
        sample: ObservedSample,
        dt: Float[Array, ""],
        settled: Bool[Array, ""],
    ) -> tuple[ShiftState, Evidence]:
        """The state after a sample, and what it says of each parameter."""
        model = self.model
        if model.directions is None:
            return state, Evidence(state.averages, state.averages, state.averages)
        change = model.directions.change(jnp.asarray(sample.mean)[model.layout.of("values")])
        share = jnp.where(state.began, -jnp.expm1(-dt / AVERAGING_SECONDS), 1.0)
        averages = jnp.where(settled, state.averages + share * (change - state.averages), 0.0)
        difference = averages - self.matched
        is_unlike = settled & (jnp.abs(difference) >= self.unlike)
        shifted = jnp.where(is_unlike, state.shifted + dt, 0.0)
        is_logarithm = np.array(model.directions.is_logarithmic)
        size = jnp.where(is_logarithm, jnp.expm1(difference), difference)
        after = ShiftState(averages, shifted, state.began | settled)
        return after, Evidence(shifted / PERSISTENT, shifted, size)

    def probability(self, place: int, size: float) -> float:
        """The probability that a parameter has changed by more than it does between recordings.

        **Arguments:**

        - `place`: the number of the parameter. `size`: its relative change, or its change.
        """
        from scipy.special import stdtr, stdtrit

        assert self.model.directions is not None
        is_logarithm = self.model.directions.is_logarithmic[place]
        difference = abs(math.log1p(max(size, -0.99)) if is_logarithm else size)
        unlike, freedom = (float(values[place]) for values in (self.unlike, self.freedom))
        compared = int(np.isfinite(np.asarray(self.unlike)).sum())
        limit = -float(stdtrit(freedom, LEVEL / compared / 2))
        chance = 2 * compared * float(stdtr(freedom, -difference / unlike * limit))
        return 1 - min(1.0, chance)


# An observer needs this time to find the rig, s; of innovations and states nothing is said before.
SETTLE = 120.0


@final
class MonitorState(eqx.Module):
    """Where a monitor is between two samples.

    - `elapsed`: the time since the first sample, s. The others: where its tests are.
    """

    elapsed: Float[Array, ""]
    innovations: InnovationState
    slow: SlowState
    channels: ChannelState
    shift: ShiftState


@final
class Monitor(eqx.Module):
    """Tests each sample of an observed rig. `init` and `step` are pure functions of arrays, and run
    under `jit`, `vmap` and `scan`; `jaxtwin.monitor` runs them over a recording, and `LiveMonitor`
    beside a rig.

    **Arguments:**

    - `observer`: the filter that observes the rig.
    - `calibration`: what is healthy.
    - `response`: how a driven cell shows in the channels.
    - `seconds`: the mean time between two false alarms, s; None: all thresholds are 1, so that
      scores are the statistics themselves.
    """

    innovations: InnovationTests
    states: StateTest
    channels: ChannelTests
    shift: ShiftTest

    def __repr__(self) -> str:
        return f"<Monitor of {len(self.innovations.scales)} channels>"

    def __init__(
        self,
        observer: ExtendedKalmanFilter,
        calibration: MonitorCalibration,
        response: Response,
        seconds: float | int | None,
    ):
        model, names = observer.model, channels_of(observer.model)
        table = {} if seconds is None else calibration.for_seconds(seconds)
        limits = np.array([table.get(family, 1.0) for family in FAMILIES])
        self.innovations = InnovationTests(
            scales=np.array([calibration.scales.get(name, 1.0) for name in names]),
            lag_one_correlation=np.array([calibration.memory.get(name, 0.0) for name in names]),
            thresholds=limits[:4],
            reset_score=np.array(math.inf if seconds is None else RESET_SCORE),
            interval=model.interval,
        )
        self.states = StateTest(model, np.array(main_parameters(model), int), limits[4:])
        still = np.array([calibration.still.get(name, math.inf) for name in names])
        self.channels = ChannelTests(model, response, still)
        self.shift = ShiftTest(model, calibration.references)

    @property
    def model(self) -> AugmentedModel:
        """The model of the observer."""
        return self.states.model

    @property
    def thresholds(self) -> dict[str, float]:
        """Family -> threshold."""
        both = np.concatenate([self.innovations.thresholds, self.states.thresholds])
        return dict(zip(FAMILIES, both.tolist(), strict=True))

    def init(self) -> MonitorState:
        """The state before the first sample."""
        return MonitorState(
            elapsed=jnp.zeros(()),
            innovations=self.innovations.init(),
            slow=self.states.init(),
            channels=self.channels.init(),
            shift=self.shift.init(),
        )

    def step(self, state: MonitorState, sample: ObservedSample) -> tuple[MonitorState, Evidences]:
        """The state after a sample, and what all tests say of it."""
        dt = jnp.asarray(sample.dt, state.elapsed.dtype)
        elapsed = state.elapsed + dt
        settled = elapsed >= SETTLE
        innovations, of_innovations = self.innovations.step(state.innovations, sample, dt, settled)
        slow, of_states = self.states.step(state.slow, sample, dt, settled)
        channels, of_channels = self.channels.step(state.channels, sample, dt)
        shift, of_shift = self.shift.step(state.shift, sample, dt, settled)
        after = MonitorState(elapsed, innovations, slow, channels, shift)
        return after, Evidences(*of_innovations, *of_states, *of_channels, of_shift)


def channels_of(model: AugmentedModel) -> tuple[str, ...]:
    """The names of the channels that are read."""
    return tuple(model.twin.channels[column] for column in np.asarray(model.columns))


# A monitor over all samples of a recording.


def evidences_of(monitor: Monitor, observed: Observed) -> Evidences:
    """What the tests say at each sample of an observed recording, in NumPy."""
    is_sample = np.asarray(observed.is_sample)
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[is_sample], observed.filtered.states)
    expected = np.asarray(observed.filtered.expected)[is_sample]
    experiment = observed.experiment
    readings = np.asarray(experiment.temperatures)
    ambient = np.asarray(observed.samples.ambient)[is_sample]
    dt = np.diff(observed.time, prepend=observed.time[0])
    with own_settings():
        samples = observed_sample(states, expected, readings, ambient, dt)
        return first_rows(_monitored(monitor, padded_rows(samples)), len(dt))


def run(monitor: Monitor, samples: ObservedSample) -> Evidences:
    """What the tests say at each of several samples, as a function that can be transformed."""

    def take(state: MonitorState, sample: ObservedSample) -> tuple[MonitorState, Evidences]:
        return monitor.step(state, sample)

    return jax.lax.scan(take, monitor.init(), samples)[1]


# The same as a program of its own.
_monitored = persistent_jit(run)
