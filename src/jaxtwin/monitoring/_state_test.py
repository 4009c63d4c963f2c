"""The test of an observer's slow states: an observer that adapts takes a fault into them, so that
its innovations are soon those of a healthy rig again."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._jax_settings import own_settings
from ..observers import AugmentedModel
from ._evidence import Evidence, ObservedSample

# A room that is measured has this multiple of the noise of its thermometer as its spread.
ROOM_SIGMAS = 5.0


# The error of a channel is compared with its average over this time, s.
RECENT = 20.0


@final
class SlowState(eqx.Module):
    """Where the test is between two samples.

    - `outside`: for how long each state has been outside of half of its threshold, s.
    - `averages`: the averaged errors of the channels, K. `began`: whether the average has begun.
    """

    outside: Float[Array, " states"]
    averages: Float[Array, " errors"]
    began: Bool[Array, ""]


@final
class StateTest(eqx.Module):
    """Compares the slow states with their spreads: the multiples of the uncertain directions, the
    room, the unexplained heats, and the errors of single channels.

    An error of a channel may also jump by more than it does within `RECENT` seconds: that of one
    channel alone, because several jump when a camera corrects itself.

    - `main`: the parameter that each direction changes most.
    - `thresholds`: of the states, and of the errors.
    """

    model: AugmentedModel
    main: Int[np.ndarray | Array, " directions"]
    thresholds: Float[np.ndarray | Array, "2"]

    def init(self) -> SlowState:
        """The state before the first sample."""
        layout = self.model.layout
        none = jnp.zeros(layout.values + 1 + layout.heats + layout.channels)
        return SlowState(none, jnp.zeros(layout.channels), jnp.zeros((), bool))

    def step(
        self,
        state: SlowState,
        sample: ObservedSample,
        dt: Float[Array, ""],
        settled: Bool[Array, ""],
    ) -> tuple[SlowState, tuple[Evidence, Evidence]]:
        """The state after a sample, and what the slow states and the errors of the channels say."""
        model, layout, noise = self.model, self.model.layout, self.model.noise
        mean = jnp.asarray(sample.mean)
        heats, errors = mean[layout.of("heats")], mean[layout.of("channels")]
        room, measured = mean[layout.of("room")], jnp.asarray(sample.ambient)
        is_measured = jnp.isfinite(measured)
        away = jnp.where(is_measured, room - jnp.reshape(model.from_degC(measured), 1), room)
        spread = jnp.where(is_measured, ROOM_SIGMAS * noise.ambient, model.room_spread)
        scores = [away / spread, heats / noise.disturbance]
        sizes = [away, heats]
        if model.directions is not None:
            amounts = mean[layout.of("values")]
            scores.insert(0, amounts / model.directions.spreads(noise))
            change = model.directions.change(amounts)
            is_logarithm = np.array(model.directions.is_logarithmic)
            sizes.insert(0, jnp.where(is_logarithm, jnp.expm1(change), change)[self.main])
        averages = jnp.where(state.began, state.averages, errors)
        jumps = _lone(jnp.abs(errors - averages) / self._usual_jump())
        scores.append(jnp.maximum(jnp.abs(errors) / noise.channel, jumps))
        count = layout.values + 1 + layout.heats
        of_states, of_errors = jnp.asarray(self.thresholds)
        limits = jnp.where(jnp.arange(len(state.outside)) < count, of_states, of_errors)
        score = jnp.where(settled, jnp.abs(jnp.concatenate(scores)) / limits, 0.0)
        outside = jnp.where(score >= 0.5, state.outside + dt, 0.0)
        averages = averages - jnp.expm1(-dt / RECENT) * (errors - averages)
        return SlowState(outside, averages, state.began | settled), (
            Evidence(score[:count], outside[:count], jnp.concatenate(sizes)),
            Evidence(score[count:], outside[count:], errors),
        )

    def _usual_jump(self) -> Float[Array, ""]:
        """The standard deviation of the difference between an error, which is forgotten
        exponentially, and its average, K."""
        noise = self.model.noise
        return jnp.asarray(noise.channel) * jnp.sqrt(RECENT / (RECENT + noise.channel_time))


def _lone(sizes: Float[Array, " channels"]) -> Float[Array, " channels"]:
    """By how much the largest is larger than the second; 0 for all others."""
    if len(sizes) < 2:
        return jnp.zeros_like(sizes)
    second, first = jnp.sort(sizes)[-2:]
    return jnp.where(sizes == first, first - second, 0.0)


def state_names(model: AugmentedModel) -> tuple[str, ...]:
    """The names of the slow states: the main parameter of each direction, the room, and the cells
    of the unexplained heats."""
    names = parameters_of(model)
    of_directions = (names[place] for place in main_parameters(model))
    return (*of_directions, "room", *model.twin.rig.driven)


def parameters_of(model: AugmentedModel) -> tuple[str, ...]:
    """The names of the parameters that the observer takes as uncertain."""
    return () if model.directions is None else model.directions.names


def main_parameters(model: AugmentedModel) -> list[int]:
    """The parameter that each direction changes most, compared with how far it may change."""
    if model.directions is None:
        return []
    directions = model.directions
    shares = np.abs(np.asarray(directions.matrix)) / np.asarray(directions.limits)[:, None]
    return shares.argmax(axis=0).tolist()


def parameter_spreads(model: AugmentedModel) -> Float[np.ndarray, " parameters"]:
    """The standard deviation of the change of each parameter before anything was read."""
    if model.directions is None:
        return np.zeros(0)
    with own_settings():
        spreads = np.asarray(model.directions.spreads(model.noise))
    return np.linalg.norm(np.asarray(model.directions.matrix) * spreads, axis=1)
