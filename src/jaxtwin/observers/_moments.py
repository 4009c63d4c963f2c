"""Mean and standard deviation of what people ask about an augmented state."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._augmented_model import AugmentedModel


class Moment(NamedTuple):
    """The mean and the standard deviation of a vector."""

    mean: Float[Array | np.ndarray, "*size"]
    spread: Float[Array | np.ndarray, "*size"]


class Moments(NamedTuple):
    """What a distribution of the state says of each part.

    - `nodes`: the temperatures of all nodes, degC.
    - `channels`: what the channels see, without errors of their readings, degC.
    - `room`: degC. `heats`: the disturbance heats, W.
    - `common`: the error that the readings of all channels share, K.
    - `values`: the changes of the uncertain values, of their logarithm where they change by that.
    """

    nodes: Moment
    channels: Moment
    room: Moment
    heats: Moment
    common: Moment
    values: Moment


def moments(
    model: AugmentedModel, mean: Float[Array, " state"], covariance: Float[Array, "state state"]
) -> Moments:
    """The moments of each part."""
    layout = model.layout
    seen = model.read(mean)
    error = mean[layout.of("common")].sum(keepdims=True)
    # Readings without their errors.
    of_errors = jnp.zeros(layout.size, bool)
    of_errors = of_errors.at[layout.of("common")].set(True).at[layout.of("channels")].set(True)
    sight = jnp.where(of_errors, 0.0, seen.slope)
    bare = seen.mean - error
    if layout.channels:
        bare = bare - mean[layout.of("channels")]

    def part(name: str, matrix: Array | None = None) -> Float[Array, "rows state"]:
        block = layout.of(name)
        picked = jnp.eye(layout.size, dtype=mean.dtype)[block]
        return picked if matrix is None else matrix @ picked

    def moment(value: Array, rows: Array) -> Moment:
        variance = jnp.einsum("rs,st,rt->r", rows, covariance, rows)
        return Moment(value, jnp.sqrt(jnp.maximum(variance, 0.0)))

    shapes, common = part("modes", model.shapes), part("common").sum(axis=0, keepdims=True)
    if model.directions is None:
        values = moment(jnp.zeros(0, mean.dtype), jnp.zeros((0, layout.size), mean.dtype))
    else:
        amounts = mean[layout.of("values")]
        rows = jax.jacfwd(model.directions.change)(amounts)
        values = moment(model.directions.change(amounts), part("values", rows))
    return Moments(
        nodes=moment(model.to_degC(model.deviation(mean)), shapes),
        channels=moment(model.to_degC(bare), sight),
        room=moment(model.to_degC(mean[layout.of("room")]), part("room")),
        heats=moment(mean[layout.of("heats")], part("heats")),
        common=moment(error, common),
        values=values,
    )
