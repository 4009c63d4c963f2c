r"""How far a state has followed the plate when a recording begins, by the network of the twin.

What happened before a recording is not known. It is described by heat that flows at random into the
sides of the cells, equally at all frequencies (white noise). The network with heat capacities $C$
and conductances $G$ answers with temperatures whose covariance $P$ solves a Lyapunov equation,

$$G P C + C P G = Q,$$

in closed form in the network's modes. If the first reading $w^T T$ lies $a$ above the room, then a
state $h^T T$ lies $\beta a$ above it, with

$$\beta = \frac{h^T P w}{w^T P w}, \qquad
\sigma_\beta^2 = \frac{h^T P h}{w^T P w} - \beta^2.$$

The size of the random heat cancels. A wall that takes hours thus begins near the room, a heater
that takes seconds near the plate.
"""

from collections.abc import Sequence
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..physics import Twin

RISE = 10.0
"""The rise above the room at which nonlinear losses are linearised, K."""


class Share(NamedTuple):
    """The share of the plate's distance from the room that a state is expected to have at the
    start, with its standard deviation."""

    mean: float
    standard_deviation: float


@final
class _Network(NamedTuple):
    """The linear network: heat capacities, conductances, the weights of the nodes in the mean
    reading, and the derivatives of the temperatures at the start with respect to parameters."""

    capacitance: Float[Array, " nodes"]
    conductance: Float[Array, "nodes nodes"]
    reading: Float[Array, " nodes"]
    starts: Float[Array, "nodes parameters"]


def starting_shares(twin: Twin, names: Sequence[str]) -> dict[str, Share]:
    """The shares of states whose temperatures at the start are parameters.

    **Arguments:**

    - `names`: the parameters.
    """
    if not names:
        return {}
    values = np.array([float(twin.values[name]) for name in names])
    with own_settings():
        network = _network(twin, tuple(names), jnp.asarray(values))
    covariance = _covariance(network, np.concatenate([twin.wiring.cold, twin.wiring.hot]))
    reading = np.asarray(network.reading)
    of_reading = float(reading @ covariance @ reading)
    shares = {}
    for name, moved in zip(names, np.asarray(network.starts).T, strict=True):
        state = moved / moved.sum()
        mean = float(state @ covariance @ reading) / of_reading
        variance = float(state @ covariance @ state) / of_reading - mean**2
        shares[name] = Share(mean, float(np.sqrt(max(variance, 0.0))))
    return shares


@persistent_jit_unoptimised
def _network(twin: Twin, names: tuple[str, ...], values: Float[Array, " parameters"]) -> _Network:
    """The linear network about a uniform rise above the room."""
    system = twin.system(lumped=False)
    room, duty = system.ambient_temperature, jnp.zeros(len(twin.rig.cells))

    def heat(deviation: Array) -> Array:
        return system.heat_into_nodes(deviation, duty, room)

    def starts(values: Array) -> Array:
        started = twin.with_values(dict(zip(names, values, strict=True)))
        return started.system(lumped=False).initial_temperature

    slopes = jax.jacfwd(heat)(jnp.full_like(system.capacitance, RISE))
    reading = jnp.asarray(system.channel_weights).mean(axis=0)
    return _Network(system.capacitance, -slopes, reading, jax.jacfwd(starts)(values))


def _covariance(
    network: _Network, heated: Int[np.ndarray, " sides"]
) -> Float[np.ndarray, "nodes nodes"]:
    """The stationary covariance of the nodes' temperatures under independent white heat into some
    nodes, up to a factor."""
    root = 1 / np.sqrt(np.asarray(network.capacitance))
    scaled = root[:, None] * np.asarray(network.conductance) * root
    # Without current through the cells the network is symmetric, up to rounding.
    rates, modes = np.linalg.eigh((scaled + scaled.T) / 2)
    drive = modes[heated].T * root[heated]
    shapes = root[:, None] * modes
    return shapes @ (drive @ drive.T / np.add.outer(rates, rates)) @ shapes.T
