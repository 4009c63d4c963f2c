r"""The modes of a rig's thermal network, with its cells taken linearly at their operating point.

A rig is linear but for its few thermoelectric nodes:

$$C \dot x = -G x + q(x, u).$$

Near the drive's mean duty cycle the cells' heat flows are $q \approx q_0 - S (x - x_0)$: the
Peltier heat of the current that flows there, and the conductance of the Seebeck voltage
($\alpha^2 T / R$, several W/K).
The symmetric part of $S$ joins the network, whose modes $V$ ($V^T C V = 1$,
$V^T (G + S) V = \Lambda$, one symmetric eigenproblem a draw) carry everything that is stiff.
"""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics import System

TYPICAL_TEMPERATURE = 330.0
"""Of a cell's sides, K: where the search for the operating point starts."""

NEWTON_STEPS = 4

BELIEVABLE = (200.0, 600.0)
"""Temperatures of an operating point, K: a draw may describe a rig that runs away."""


@final
class Modes(eqx.Module):
    """Modes of the network: `rates` (1/s) and `shapes`, temperatures = shapes @ amplitudes.

    `capacitance` is what the shapes are normalised with, `relief` the heat flow out of the cells'
    sides (all cold, then all hot) per kelvin that has joined the network, W/K.
    """

    rates: Float[Array, " modes"]
    shapes: Float[Array, "nodes modes"]
    capacitance: Float[Array, " nodes"]
    relief: Float[Array, "sides sides"]

    def amplitudes(self, deviation: Float[Array, " nodes"]) -> Float[Array, " modes"]:
        """The modes' parts in given temperatures: the inverse of the shapes is shapes^T C."""
        return self.shapes.T @ (self.capacitance * deviation)


def network_modes(
    system: System, duty: Float[Array, " cells"], reference: Float[Array, ""]
) -> Modes:
    """Solves the eigenproblem of a network; gradients do not pass through it.

    **Arguments:**

    - `duty`: where the cells are taken linearly, -1 to 1.
    - `reference`: what deviations are counted from, K.
    """
    system, duty, reference = jax.lax.stop_gradient((system, duty, reference))
    sides = np.concatenate([system.wiring.cold, system.wiring.hot])
    relief = _relief(system, duty, reference, sides)
    conductance = system.conductance.at[np.ix_(sides, sides)].add(relief)
    scale = 1 / jnp.sqrt(system.capacitance)
    rates, vectors = jnp.linalg.eigh(conductance * scale[:, None] * scale[None, :])
    return Modes(rates, scale[:, None] * vectors, system.capacitance, relief)


def _relief(
    system: System,
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
    sides: np.ndarray,
) -> Float[Array, "sides sides"]:
    """The symmetric part of -dq/dx where the rig comes to rest under a duty cycle.

    Newton's method on the sides alone: x = Z q(x) with Z the network's thermal resistances seen
    from them. A few kelvin are near enough.
    """

    def heat(deviation: Array) -> Array:
        flows = system.cell_heat(deviation + reference, duty)
        return jnp.concatenate([-flows.cold, flows.hot])

    seen = jnp.linalg.solve(system.conductance, jnp.eye(system.capacitance.size)[:, sides])[sides]
    unit = jnp.eye(sides.size, dtype=seen.dtype)
    lowest, highest = (bound - reference for bound in BELIEVABLE)
    at = jnp.full(sides.size, TYPICAL_TEMPERATURE, seen.dtype) - reference
    for _ in range(NEWTON_STEPS):
        flow, slope = heat(at), jax.jacfwd(heat)(at)
        at = at - jnp.linalg.solve(unit - seen @ slope, at - seen @ flow)
        at = jnp.clip(at, lowest, highest)
    slope = jax.jacfwd(heat)(at)
    return -(slope + slope.T) / 2
