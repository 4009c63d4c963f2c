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
from jaxtyping import Array, Float, Int

from .._lapack import eigh, solve
from ..physics import System

TYPICAL_TEMPERATURE = 330.0
"""Of a cell's sides, K: where the search for the operating point starts."""

NEWTON_STEPS = 4

BELIEVABLE = (200.0, 600.0)
"""Temperatures of an operating point, K: a draw may describe a rig that runs away."""


@final
class Modes(eqx.Module):
    """Modes of the network: `rates` (1/s) and `shapes`, temperatures = shapes @ amplitudes.

    `sides` are the rows of the shapes at the cells' sides (all cold, then all hot), `plate` those
    of the plate where its losses are not linear, else None.
    `capacitance` is what the shapes are normalised with, `relief` the heat flow out of the cells'
    sides per kelvin that has joined the network, W/K, `film` the same for what the plate loses
    beyond its linear film, None for nothing, and `operating_point` where that was taken: the
    sides' deviations, K.
    """

    rates: Float[Array, " modes"]
    shapes: Float[Array, "nodes modes"]
    sides: Float[Array, "sides modes"]
    plate: Float[Array, "elements modes"] | None
    capacitance: Float[Array, " nodes"]
    relief: Float[Array, "sides sides"]
    film: Float[Array, " elements"] | None
    operating_point: Float[Array, " sides"]

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
    rest = _at_rest(system, duty, reference, sides)
    slope = _slope(system, rest[sides], duty, reference)
    relief = -(slope + slope.T) / 2
    conductance = system.conductance.at[np.ix_(sides, sides)].add(relief)
    film, plate = None, None
    if system.loss is not None:
        plate = np.arange(system.wiring.elements)
        film = system.loss.slope(rest[plate], reference)
        conductance = conductance.at[plate, plate].add(film)
    scale = 1 / jnp.sqrt(system.capacitance)
    rates, vectors = eigh(conductance * scale[:, None] * scale[None, :])
    shapes = scale[:, None] * vectors
    return Modes(
        rates=rates,
        shapes=shapes,
        sides=shapes[sides],
        plate=None if plate is None else shapes[plate],
        capacitance=system.capacitance,
        relief=relief,
        film=film,
        operating_point=rest[sides],
    )


def left_coupling(
    system: System,
    modes: Modes,
    duty: Float[Array, "levels cells"],
    reference: Float[Array, ""],
    step: Float[Array, ""],
) -> Float[Array, ""]:
    """How strongly the cells act on themselves beyond the modes, within one step.

    The largest row sum of |what a heat flow at the sides does to their temperatures in a step| x
    |what is left of -dq/dx| over some duty cycles: an explicit treatment of the rest is safe well
    below 1.
    """
    x = modes.rates * step
    answer = jnp.where(jnp.abs(x) < 1e-6, 1.0, -jnp.expm1(-x) / jnp.where(x == 0, 1.0, x)) * step
    warms = jnp.abs(modes.sides * answer @ modes.sides.T)

    def rest(duty: Array) -> Array:
        slope = _slope(system, modes.operating_point, duty, reference)
        return (warms @ jnp.abs(modes.relief + slope)).sum(axis=1).max()

    return jax.vmap(rest)(duty).max()


def _at_rest(
    system: System, duty: Float[Array, " cells"], reference: Float[Array, ""], sides: np.ndarray
) -> Float[Array, " nodes"]:
    """About where the rig comes to rest under a duty cycle: deviations.

    Newton's method on the cells' sides alone: x = Z q(x) with Z the network's thermal resistances
    seen from them. A few kelvin are near enough; losses are taken as linear.
    """
    warmed = solve(system.conductance, jnp.eye(system.capacitance.size)[:, sides])
    seen = warmed[sides]
    unit = jnp.eye(sides.size, dtype=seen.dtype)
    lowest, highest = (bound - reference for bound in BELIEVABLE)

    def newton(_: Int[Array, ""], at: Float[Array, " sides"]) -> Float[Array, " sides"]:
        slope = _slope(system, at, duty, reference)
        change = at - seen @ _flow(system, at, duty, reference)
        return jnp.clip(at - solve(unit - seen @ slope, change), lowest, highest)

    start = jnp.full(sides.size, TYPICAL_TEMPERATURE, seen.dtype) - reference
    at = jax.lax.fori_loop(0, NEWTON_STEPS, newton, start)
    return jnp.clip(warmed @ _flow(system, at, duty, reference), lowest, highest)


def _flow(system: System, at: Array, duty: Array, reference: Array) -> Float[Array, " sides"]:
    """q, the cells' heat into their sides, W."""
    flows = system.cell_heat(at + reference, duty)
    return jnp.concatenate([-flows.cold, flows.hot])


def _slope(system: System, at: Array, duty: Array, reference: Array) -> Float[Array, "sides sides"]:
    return jax.jacfwd(lambda at: _flow(system, at, duty, reference))(at)
