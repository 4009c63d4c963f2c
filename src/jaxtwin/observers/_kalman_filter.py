"""The extended Kalman filter of a twin."""

from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ._augmented_model import AugmentedModel, ExpectedReading, Transition
from ._commands import Commands
from ._expected_correction import Jump, expected_jump
from ._gaussian import LOG_TWO_PI, Gaussian, GaussianUpdate, measurement_update, time_update
from ._observer import AbstractObserver
from ._start import start_of

# A common innovation of this many standard deviations is taken for a correction of the camera.
CORRECTION_SIGMAS = 4.0

# From one of this many on, the time to the next correction is counted.
CERTAIN_CORRECTION_SIGMAS = 6.0

# A reading whose innovation is more standard deviations than this is rejected: no noise is as
# large, and what happens in a rig shows in several samples.
GATE_SIGMAS = 10.0

# No smaller innovation is rejected: cameras correct themselves by up to 2 K.
MIN_GATE_KELVIN = 3.0

# The number of samples in sequence at which a channel is rejected. What lasts longer has happened,
# and is followed.
MAX_REJECTED = 3

# A channel that is followed is not rejected again before it has been inside of the gate for the
# samples by which this exceeds `MAX_REJECTED`: a twin that is wrong pulls away from its readings.
FOLLOW_COUNT = MAX_REJECTED + 60


@final
class KalmanState(eqx.Module):
    """What an `ExtendedKalmanFilter` knows.

    - `mean`, `covariance`: of the augmented state, see `AugmentedModel`.
    - `duty`: the duty that reaches the cells. `commands`: those in the driver's delay.
    - `slope`: the expected change of the readings, K/s.
    - `since_correction`: the time since the last correction of the camera that was seen, s;
      infinite before the first.
    - `rejected`: for how many samples in sequence each channel has been rejected, because it was
      outside of the gate (`GATE_SIGMAS`); from `MAX_REJECTED` to `FOLLOW_COUNT`: it is followed.
    - `is_rejected`: whether the last reading of each channel was rejected.
    - `whitened`: the whitened innovations of the last readings, 0 where none was used.
    - `log_likelihood`: of the last readings.
    """

    mean: Float[Array, " state"]
    covariance: Float[Array, "state state"]
    duty: Float[Array, " cells"]
    commands: Commands
    slope: Float[Array, " channels"]
    since_correction: Float[Array, ""]
    rejected: Float[Array, " channels"]
    is_rejected: Bool[Array, " channels"]
    whitened: Float[Array, " channels"]
    log_likelihood: Float[Array, ""]

    @property
    def gaussian(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.covariance)


class Measured(NamedTuple):
    """What is measured at a sample: the room, which is first, and the channels.

    - `values`: deviations from the reference, K; anything where `mask` is false.
    - `variance`: that of the noise of each, K^2.
    - `mask`: those that count.
    - `far`: those that are outside of the gate. `rejected`: those that therefore do not count.
    - `log_density`: what the density of the rejected ones counts as: that of the gate.
    - `added_variance`: what is added to the variance of the state, because the camera corrected
      itself.
    - `is_certain`: whether it certainly did.
    """

    values: Float[Array, " readings"]
    variance: Float[Array, " readings"]
    mask: Bool[Array, " readings"]
    far: Bool[Array, " readings"]
    rejected: Bool[Array, " readings"]
    log_density: Float[Array, ""]
    added_variance: Float[Array, " state"]
    is_certain: Bool[Array, ""]


@final
class ExtendedKalmanFilter(AbstractObserver[KalmanState]):
    """Estimates the state of a rig with its uncertainty, and what drives it beside the duty.

    `jaxtwin.observe` makes one for a recording and runs it. Its state is described by
    `AugmentedModel`.

    **Arguments:**

    - `model`: the twin with the states of the observer.
    - `longest_step`: the longest step that is taken at once, s.
    - `shortest_step`: the shortest time between two commands that are told apart, s.
    """

    model: AugmentedModel
    held: int = eqx.field(static=True)
    """The number of commands that a state holds."""
    spacing: Float[ArrayLike, ""]
    """Commands that follow each other faster than this are taken as one, s."""
    longest_step: Float[ArrayLike, ""]

    def __repr__(self) -> str:
        return f"<ExtendedKalmanFilter of {self.model.twin.rig.name}>"

    def __init__(self, model: AugmentedModel, longest_step: float, shortest_step: float = 0.1):
        self.model = model
        self.longest_step = np.asarray(longest_step)
        delay = model.stepper.system.delay
        longest = 0.0 if delay is None else 2.0 * float(delay) + 1.0
        # Times of loggers differ by rounding, which must not change the number.
        self.held = 1 + int(np.ceil(longest / shortest_step - 0.01)) + (delay is not None)
        self.spacing = np.asarray(0.5 * shortest_step)

    @property
    def longest_seconds(self) -> float:
        """The longest step that is taken at once, s, as a number of Python."""
        return float(np.asarray(self.longest_step))

    def init(
        self, nodes: Float[ArrayLike, "..."] | None, duty: Float[ArrayLike, " cells"]
    ) -> KalmanState:
        """The state at the start.

        A single temperature is taken as that of what the channels read, and the rest of the rig as
        having been heated at random before; see `_start`.
        """
        model = self.model
        layout = model.layout
        start = start_of(model, nodes)
        held = jnp.asarray(duty, start.mean.dtype)
        if layout.duty:
            start = Gaussian(start.mean.at[layout.of("duty")].set(held), start.covariance)
        none = jnp.zeros(len(model.columns), start.mean.dtype)
        return KalmanState(
            mean=start.mean,
            covariance=start.covariance,
            duty=held,
            commands=Commands.held(held, self.held),
            slope=none,
            since_correction=jnp.asarray(jnp.inf, start.mean.dtype),
            rejected=none,
            is_rejected=jnp.zeros(none.shape, bool),
            whitened=none,
            log_likelihood=jnp.zeros((), start.mean.dtype),
        )

    def predict(
        self,
        state: KalmanState,
        duty: Float[ArrayLike, " cells"],
        ambient: Float[ArrayLike, ""],
        dt: Float[ArrayLike, ""],
    ) -> KalmanState:
        """The state after `dt` seconds with a duty, in steps of at most the longest step."""
        del ambient  # it is a reading of the room
        dt = jnp.asarray(dt, state.mean.dtype)
        parts = jnp.maximum(jnp.ceil(dt / self.longest_step - 1e-9), 1.0)
        command = jnp.asarray(duty, dt.dtype)
        return jax.lax.fori_loop(
            0, parts.astype(int), lambda _, s: self.step(s, command, dt / parts), state
        )

    def step(
        self,
        state: KalmanState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> KalmanState:
        """The state after a single step; differentiable forwards and backwards.

        `levels` are the rig's other inputs (`simulation._input_levels`), None for those of the rig
        file.
        """
        return self.linearised_step(state, command, dt, levels)[0]

    def linearised_step(
        self,
        state: KalmanState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> tuple[KalmanState, Transition]:
        """The state after a single step, and the linearisation of the step at the state before,
        which does not contain an expected correction of the camera."""
        commands, dt = self.commands(state, command, dt)
        transition, duty = self.model.step(state.mean, state.duty, commands, dt, levels)
        after = self.predicted(state, transition, dt)
        return self.stepped(state, after, duty, commands, dt), transition

    def predicted(
        self, state: KalmanState, transition: Transition, dt: Float[Array, ""]
    ) -> Gaussian:
        """The distribution after a step, with the correction of the camera that is expected in
        it."""
        after, jump = time_update(state.gaussian, *transition), self.expected_jump(state, dt)
        return Gaussian(after.mean + jump.mean, after.covariance + jnp.diag(jump.variance))

    def predict_mean(
        self,
        state: KalmanState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> KalmanState:
        """The time update of the mean alone. The covariance, which takes most of the time, stays as
        it was."""
        commands, dt = self.commands(state, command, dt)
        mean, duty = self.model.predict_mean(state.mean, state.duty, commands, dt, levels)
        mean = mean + self.expected_jump(state, dt).mean
        return self.stepped(state, Gaussian(mean, state.covariance), duty, commands, dt)

    def expected_jump(self, state: KalmanState, dt: Float[Array, ""]) -> Jump:
        """What a correction of the camera that is expected within a step adds to the state."""
        return expected_jump(self.model, state.since_correction, dt)

    def with_room_temperature(
        self, state: KalmanState, ambient: Float[ArrayLike, ""]
    ) -> KalmanState:
        """The state with this mean of the room, degC; NaN leaves it. The covariance stays."""
        place, room = self.model.layout.of("room").start, self.model.from_degC(jnp.asarray(ambient))
        known = jnp.where(jnp.isfinite(room), room, state.mean[place])
        return replace(state, mean=state.mean.at[place].set(known))

    def commands(
        self, state: KalmanState, command: Float[ArrayLike, " cells"], dt: Float[ArrayLike, ""]
    ) -> tuple[Commands, Float[Array, ""]]:
        """The commands during a step, and its length as an array."""
        dt = jnp.asarray(dt, state.mean.dtype)
        return state.commands.given(jnp.asarray(command, dt.dtype), self.spacing), dt

    def stepped(
        self,
        before: KalmanState,
        after: Gaussian,
        duty: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
    ) -> KalmanState:
        """The state after a step whose distribution, duty in the cells and commands are known."""
        return replace(
            before,
            mean=after.mean,
            covariance=after.covariance,
            duty=duty,
            commands=commands.older(dt),
            since_correction=before.since_correction + dt,
            slope=self.model.slope_of_readings(before.mean, after.mean, dt, before.slope),
        )

    def update(
        self,
        state: KalmanState,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
        expected: ExpectedReading | None = None,
    ) -> KalmanState:
        """The measurement update with readings, and with a measured ambient temperature (NaN if
        there is none). `expected` are the expected readings and their derivatives, if the caller
        has computed them."""
        expected = self.model.read(state.mean) if expected is None else expected
        measured = self.measured(state, expected, readings, mask, ambient)
        result = self._measurement_update(state, expected, measured)
        return self.updated(state, result.state.mean, result, measured)

    def updated(
        self,
        state: KalmanState,
        mean: Float[Array, " state"],
        by: GaussianUpdate,
        measured: Measured,
    ) -> KalmanState:
        """The state after a measurement update: the given mean, the covariance, the counts of
        rejected readings, and the log likelihood."""
        duty, since = self.model.layout.of("duty"), state.since_correction
        used, far, rejected = (
            rows[1:] for rows in (measured.mask, measured.far, measured.rejected)
        )
        count = state.rejected
        outside = jnp.where(count < MAX_REJECTED, count + 1, FOLLOW_COUNT)
        inside = jnp.where(count > MAX_REJECTED, count - 1, 0.0)
        return replace(
            state,
            mean=mean,
            since_correction=jnp.where(measured.is_certain, jnp.zeros_like(since), since),
            # A missing reading does not say whether what was seen before it lasts.
            rejected=jnp.where(used | rejected, jnp.where(far, outside, inside), count),
            is_rejected=rejected,
            covariance=by.state.covariance,
            duty=mean[duty] if self.model.layout.duty else state.duty,
            whitened=by.whitened[1:],
            log_likelihood=by.log_densities[1:].sum() + measured.log_density,
        )

    def measurement_update(
        self,
        state: KalmanState,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> GaussianUpdate:
        """The measurement update with its gain; the room is the first reading."""
        expected = self.model.read(state.mean)
        measured = self.measured(state, expected, readings, mask, ambient)
        return self._measurement_update(state, expected, measured)

    def _measurement_update(
        self, state: KalmanState, expected: ExpectedReading, measured: Measured
    ) -> GaussianUpdate:
        with_room = self._with_room(state.mean, expected)
        return measurement_update(
            Gaussian(state.mean, state.covariance + jnp.diag(measured.added_variance)),
            measured.values - with_room.mean,
            with_room.slope,
            measured.variance,
            measured.mask,
            self.model.layout.of("values"),
        )

    def measured(
        self,
        state: KalmanState,
        expected: ExpectedReading,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> Measured:
        """The room, which is first, and the readings with their noise, where a state expects
        them."""
        model = self.model
        values = model.from_degC(jnp.asarray(readings, state.mean.dtype))
        used = jnp.asarray(mask) & jnp.isfinite(values)
        variance = self.reading_variance(state)
        innovation = values - expected.mean
        added_variance, is_certain = self.added_variance(
            state.gaussian, expected, innovation, variance, used
        )
        predicted = state.covariance + jnp.diag(added_variance)
        of_innovation = variance + ((expected.slope @ predicted) * expected.slope).sum(axis=1)
        gate = jnp.maximum(GATE_SIGMAS**2 * of_innovation, MIN_GATE_KELVIN**2)
        far = used & (innovation**2 > gate)
        rejected = far & (state.rejected < MAX_REJECTED)
        # Otherwise a likelihood would gain by every reading that is rejected.
        densities = -0.5 * (GATE_SIGMAS**2 + LOG_TWO_PI + jnp.log(of_innovation))
        is_read = (used & ~rejected).any()
        room = model.from_degC(jnp.asarray(ambient, state.mean.dtype))
        no = jnp.zeros(1, bool)
        return Measured(
            values=jnp.concatenate([room[None], values]),
            variance=jnp.concatenate([jnp.reshape(model.noise.ambient**2, 1), variance]),
            mask=jnp.concatenate([jnp.isfinite(room)[None], used & ~rejected]),
            far=jnp.concatenate([no, far]),
            rejected=jnp.concatenate([no, rejected]),
            log_density=jnp.where(rejected, densities, 0.0).sum(),
            added_variance=jnp.where(is_read, added_variance, 0.0),
            is_certain=is_certain & is_read,
        )

    def expected(self, mean: Float[Array, " state"]) -> ExpectedReading:
        """The room, which is first, and the readings that a mean lets expect."""
        return self._with_room(mean, self.model.read(mean))

    def _with_room(
        self, mean: Float[Array, " state"], expected: ExpectedReading
    ) -> ExpectedReading:
        place = self.model.layout.of("room").start
        of_room = jnp.zeros_like(mean).at[place].set(1.0)
        return ExpectedReading(
            jnp.concatenate([mean[place][None], expected.mean]),
            jnp.concatenate([of_room[None], expected.slope]),
        )

    def reading_variance(self, state: KalmanState) -> Float[Array, " channels"]:
        """The variance of the noise of each reading, K^2."""
        noise = self.model.noise
        return jnp.asarray(noise.reading) ** 2 + (noise.reading_time * state.slope) ** 2

    def added_variance(
        self,
        state: Gaussian,
        expected: ExpectedReading,
        innovation: Float[Array, " channels"],
        variance: Float[Array, " channels"],
        used: Bool[Array, " channels"],
    ) -> tuple[Float[Array, " state"], Bool[Array, ""]]:
        """The variance that a state gains by readings of which all channels jumped, because the
        common error of a camera that has corrected itself is unknown again; and whether it
        certainly has."""
        none = jnp.zeros_like(state.mean)
        if not self.model.relaxation:
            return none, jnp.zeros((), bool)
        count = jnp.maximum(used.sum(), 1)
        weights = used / count
        row = weights @ expected.slope
        spread = row @ state.covariance @ row + weights**2 @ variance
        common = weights @ jnp.where(used, innovation, 0.0)
        # As much as it takes to explain the jump.
        added_variance = jnp.clip(
            common**2 - CORRECTION_SIGMAS**2 * spread, 0.0, self.model.noise.jump**2
        )
        is_certain = common**2 > CERTAIN_CORRECTION_SIGMAS**2 * spread
        return none.at[self.model.layout.fading].set(added_variance), is_certain

    def readings(
        self, state: KalmanState, ambient: Float[ArrayLike, ""]
    ) -> Float[Array, " channels"]:
        return self.model.to_degC(self.model.read(state.mean).mean)

    def reading_covariance(self, state: KalmanState) -> Float[Array, "channels channels"]:
        """The covariance of the readings that a state lets expect, K^2."""
        slope = self.model.read(state.mean).slope
        return slope @ state.covariance @ slope.T + jnp.diag(self.reading_variance(state))

    def nodes(self, state: KalmanState) -> Float[Array, " nodes"]:
        return self.model.to_degC(self.model.deviation(state.mean))
