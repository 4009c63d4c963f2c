"""The test of an observer's slow states: an observer that adapts takes a fault into them, so that
its innovations are soon those of a healthy rig again."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._jax_settings import own_settings
from ..observers._augmented_model import AugmentedModel
from ._evidence import Evidence, Seen

ROOM = 5.0
"""A room that is measured has this multiple of the noise of its thermometer as its spread."""


@final
class StateTest(eqx.Module):
    """Compares the slow states with their spreads: the multiples of the uncertain directions, the
    room, the unexplained heats, and the errors of single channels.

    - `main`: the parameter that each direction changes most.
    - `thresholds`: of the states, and of the errors.
    """

    model: AugmentedModel
    main: Int[np.ndarray | Array, " directions"]
    thresholds: Float[np.ndarray | Array, "2"]

    def init(self) -> Float[Array, " states"]:
        """For how long each state has been outside of half of its threshold, s."""
        layout = self.model.layout
        return jnp.zeros(layout.values + 1 + layout.heats + layout.channels)

    def step(
        self,
        outside: Float[Array, " states"],
        seen: Seen,
        dt: Float[Array, ""],
        settled: Bool[Array, ""],
    ) -> tuple[Float[Array, " states"], tuple[Evidence, Evidence]]:
        """The times after a sample, and what the states and the errors of the channels say."""
        model, layout, noise = self.model, self.model.layout, self.model.noise
        mean = jnp.asarray(seen.mean)
        heats, errors = mean[layout.of("heats")], mean[layout.of("channels")]
        room, measured = mean[layout.of("room")], jnp.asarray(seen.ambient)
        is_measured = jnp.isfinite(measured)
        away = jnp.where(is_measured, room - jnp.reshape(model.from_degC(measured), 1), room)
        spread = jnp.where(is_measured, ROOM * noise.ambient, model.room_spread)
        scores = [away / spread, heats / noise.disturbance, errors / noise.channel]
        sizes = [away, heats]
        if model.directions is not None:
            amounts = mean[layout.of("values")]
            scores.insert(0, amounts / model.directions.spreads(noise))
            change = model.directions.change(amounts)
            is_logarithm = np.array(model.directions.is_logarithmic)
            sizes.insert(0, jnp.where(is_logarithm, jnp.expm1(change), change)[self.main])
        count = layout.values + 1 + layout.heats
        of_states, of_errors = jnp.asarray(self.thresholds)
        limits = jnp.where(jnp.arange(len(outside)) < count, of_states, of_errors)
        score = jnp.where(settled, jnp.abs(jnp.concatenate(scores)) / limits, 0.0)
        outside = jnp.where(score >= 0.5, outside + dt, 0.0)
        return outside, (
            Evidence(score[:count], outside[:count], jnp.concatenate(sizes)),
            Evidence(score[count:], outside[count:], errors),
        )


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
