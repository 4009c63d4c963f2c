"""Tests of single readings: of a channel that is frozen, of one that has gone to the room, and of
one that was impossible for a moment."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._celsius import ZERO_CELSIUS
from ..observers._augmented_model import AugmentedModel
from ._evidence import Evidence, Seen
from ._response import Response

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
        self, state: ChannelState, seen: Seen, dt: Float[Array, ""]
    ) -> tuple[ChannelState, tuple[Evidence, Evidence, Evidence]]:
        """The state after a sample, and what it says of frozen, gone and impossible channels."""
        readings = jnp.asarray(seen.readings)
        there = jnp.isfinite(readings)
        # A missing reading says nothing; another one ends the sequence.
        equal = there & (readings == state.reading)
        goes_on = equal | ~there
        count = jnp.where(goes_on, state.equal + equal, 0.0)
        still = jnp.where(goes_on, state.still + dt, 0.0)
        moved = jnp.where(goes_on, state.moved + jnp.abs(jnp.asarray(seen.slope)) * dt, 0.0)
        enough = jnp.clip(moved / (MIN_EXPECTED_MOVE_SIGMAS * self.model.noise.reading), 1 / 3, 1.0)
        frozen = Evidence(count / self.still * enough, still, moved)

        duty = jnp.asarray(seen.duty)
        saturated = jnp.stack([duty, -duty]) >= SATURATED_DUTY
        driven = jnp.where(saturated, state.driven + dt, 0.0)
        shows = (driven[:, :, None] >= jnp.asarray(self.response.seconds)).any(axis=(0, 1))
        measured = jnp.asarray(seen.ambient)
        stated = self.model.stepper.reference - ZERO_CELSIUS
        away = readings - jnp.where(jnp.isfinite(measured), measured, stated)
        is_near = jnp.abs(away) <= jnp.asarray(self.response.near)
        at_room = jnp.where(shows & is_near, state.at_room + dt, 0.0)
        at_room = jnp.where(there, at_room, state.at_room)
        gone = Evidence(at_room / GONE_SECONDS, at_room, jnp.where(there, away, 0.0))
        reading = jnp.where(there, readings, state.reading)

        rejected = jnp.asarray(seen.rejected)
        since = state.since_rejected + dt
        # What lasts is followed after some samples, and then is far from what is expected.
        is_back = there & (state.rejected != 0) & jnp.asarray(seen.is_inside)
        impossible = Evidence(is_back.astype(since.dtype), since, state.rejected)
        since = jnp.where(state.rejected != 0, since, 0.0)
        rejected = jnp.where(there | (rejected != 0), rejected, state.rejected)
        return (
            ChannelState(reading, count, still, moved, driven, at_room, rejected, since),
            (frozen, gone, impossible),
        )
