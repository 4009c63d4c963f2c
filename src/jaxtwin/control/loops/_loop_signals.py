"""The signals of a closed loop, from which its measures are computed."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..controllers._controller import DutyLimits


@final
class ClosedLoop(eqx.Module):
    """The signals of a closed loop at every step of the plant, from which measures are computed.

    **Arguments:**

    - `time`: the times, s.
    - `reference`, `output`: reference and true value of the controlled temperatures, degC.
    - `measurement`: the controlled temperatures as the controller gets them, with noise, delay and
      lost messages, and then those that it only watches, degC.
    - `temperatures`: the temperatures of the channels, without noise, degC.
    - `nodes`: the temperatures of the twin's nodes, degC.
    - `duty`: the duty commanded from this time on, -1 to 1.
    - `power`: the power that each cell's bridge draws from the supply, W.
    - `energy`: the energy that all bridges together have drawn from the supply up to this time, J.
    - `peak_power`: the largest power of all bridges together at any time, also within steps, W.
    - `limits`: the lowest and the highest duty that the controller commands, each a number, or one
      for each cell and heater.
    - `elements`: the number of elements of the plate, which are the first nodes.
    - `sides`: the nodes that are sides of the cells.
    """

    time: Float[Array | np.ndarray, "*draws times"]
    reference: Float[Array | np.ndarray, "*draws times outputs"]
    output: Float[Array | np.ndarray, "*draws times outputs"]
    measurement: Float[Array | np.ndarray, "*draws times readings"]
    temperatures: Float[Array | np.ndarray, "*draws times channels"]
    nodes: Float[Array | np.ndarray, "*draws times nodes"]
    duty: Float[Array | np.ndarray, "*draws times cells"]
    power: Float[Array | np.ndarray, "*draws times cells"]
    energy: Float[Array | np.ndarray, "*draws times"]
    peak_power: Float[Array | np.ndarray, "*draws"]
    limits: DutyLimits = eqx.field(static=True)
    elements: int = eqx.field(static=True)
    sides: tuple[int, ...] = eqx.field(static=True)

    @property
    def plate(self) -> Float[Array | np.ndarray, "*draws times elements"]:
        """Temperatures of the plate's elements, degC."""
        return self.nodes[..., : self.elements]

    @property
    def cell_sides(self) -> Float[Array | np.ndarray, "*draws times sides"]:
        """Temperatures of the cells' sides, degC."""
        return self.nodes[..., np.array(self.sides)]

    @property
    def stays_finite(self) -> Bool[Array, ""]:
        """Whether a single loop has finite temperatures at its end and always a finite duty."""
        return jnp.all(jnp.isfinite(self.nodes[-1])) & jnp.all(jnp.isfinite(self.duty))
