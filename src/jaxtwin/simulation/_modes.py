r"""The modes of a rig's thermal network, with its cells linearised at their operating point.

A rig is linear except at its few thermoelectric nodes:

$$C \dot x = -G x + q(x, u).$$

Near the drive's mean duty cycle the cells' heat flows are $q \approx q_0 - S (x - x_0)$: the
Peltier heat of the current that flows there, and the conductance of the Seebeck voltage
($\alpha^2 T / R$, several W/K). The symmetric part of $S$ joins the network, whose modes $V$
($V^T C V = 1$, $V^T (G + S) V = \Lambda$, a symmetric eigenproblem for each draw) contain
everything that is stiff.
"""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._lapack import eigh, solve, solve_definite
from ..errors import SimulationError
from ..physics import Link, System, Twin
from ._rosenbrock_step import eliminate
from ._time_grid import InputSummary, reference_temperature

# The range of rates that float64 can resolve in a network.
#
# Conductances are summed, and rates found, to a part of about $\varepsilon = 2.2 \cdot 10^{-16}$ of
# the largest. Every rate then has an error of about $\varepsilon \lambda_{max}$, and a temperature
# that has followed a slow mode for a time $\tau$ a relative error of about $\varepsilon
# \lambda_{max} \tau$:
#
# $$\lambda_{max} \, \min(t_{run}, 1 / \lambda_{min}) \le 2 \cdot 10^{11}$$
#
# leaves errors below 1e-3 K. Measured with contacts and conductances of 1e-7 to 1e-13 K/W in
# `paper-2024`, `dual-cell` and `single-cell`, the error is at most 11 K times $\varepsilon
# \lambda_{max} \tau$, half a millikelvin at the limit; a circuit whose nodes are merged beforehand
# gives the same result. In a rig of a common size a contact of 1e-10 K/W is inside the limit, and
# one of 1e-12 K/W is outside.

# The largest span of the rates. A network beyond it is refused. Modes beyond it, which losses or
# cells far from their linearisation can cause, are not used: a stiff solver takes over.
MAX_SPAN = 2e11


def network_span(
    system: System, slowest: Float[Array, ""], duration: Float[Array, ""]
) -> Float[Array, ""]:
    """The span of the rates of the network: `spanned` of the fastest rate of a single node, which
    is the largest rate within a factor of 2 (Gershgorin)."""
    return spanned((jnp.diag(system.conductance) / system.capacitance).max(), slowest, duration)


def spanned(
    fastest: Float[Array, ""], slowest: Float[Array, ""], duration: Float[Array, ""]
) -> Float[Array, ""]:
    """The fastest rate (1/s) times the duration of a run or the longest time constant, whichever is
    shorter (s)."""
    # A slowest rate of 0 or below is a rounding error.
    remembered = 1 / jnp.maximum(jnp.abs(slowest), 1 / duration)
    return fastest * jnp.where(jnp.isfinite(remembered), remembered, duration)


def unresolved_network(twin: Twin) -> SimulationError:
    """Makes the error for a twin whose `network_span` is too large. It names the fastest link."""
    values, netlist = twin.numbers_si, twin.netlist
    capacitance = {node.name: float(node.capacitance.evaluate(values)) for node in netlist.nodes}

    def time_constant(link: Link) -> float:
        ends = [capacitance[end] for end in (link.a, link.b) if end in capacitance]
        return link.resistance(values) * min(ends)

    link = min(netlist.links, key=time_constant)
    return SimulationError(
        f"{twin.rig.name}: resistance {link.a} - {link.b}: expected rates that differ by a factor "
        f"of at most {MAX_SPAN:g} within the run, which float64 can tell apart, got "
        f"{link.resistance(values):g} K/W, with which a node settles within "
        f"{time_constant(link):.2g} s; raise the resistance, or make one node of the two"
    )


# The temperatures of a cell's sides at which the search for the operating point starts, K.
TYPICAL_TEMPERATURE = 330.0

NEWTON_STEPS = 4

# The largest number of unknowns for which a loop of elimination is fastest, including compilation.
FEW_SIDES = 32

# Bounds of an operating point, K, because the parameters of a draw may describe an unstable rig.
BELIEVABLE = (200.0, 600.0)


@final
class LossShapes(eqx.Module):
    """The modes at the paths of heat that is not linear.

    - `across`: the temperature at the near end of each path less that at the far end, if this is a
      node. `at_far`: that at the far end; None if no path ends at a node or at a body.
    """

    across: Float[Array, "paths modes"]
    at_far: Float[Array, "paths modes"] | None


def loss_shapes(system: System, shapes: Float[Array, "nodes modes"]) -> LossShapes | None:
    """The shapes of modes at the paths of heat that is not linear; None if all is."""
    paths = system.wiring.loss_paths
    if paths is None:
        return None
    at_far = None if paths.is_of_plate else paths.at_far(shapes)
    return LossShapes(paths.across(shapes), at_far)


@final
class Modes(eqx.Module):
    """The modes of a network: `rates` (1/s) and `shapes`, with temperatures = shapes @ amplitudes.

    `sides` are the rows of the shapes at the cells' sides (all cold, then all hot). `losses` are
    those at the paths of heat that is not linear, otherwise None. `capacitance` are the heat
    capacities by which the shapes are normalised. `linearised_conductance` is the derivative of the
    heat flow out of the cells' sides that is part of the network, W/K. `linearised_loss` is the
    same for the losses beyond the conductance matrix, or None. Both are derivatives at the
    `operating_point`: the deviations of the sides, K. `switched` are the temperature differences of
    the links that inputs change, or None, and `linearised_change` the conductance of these links
    that is part of the network in addition to the system's, W/K.
    """

    rates: Float[Array, " modes"]
    shapes: Float[Array, "nodes modes"]
    sides: Float[Array, "sides modes"]
    losses: LossShapes | None
    capacitance: Float[Array, " nodes"]
    linearised_conductance: Float[Array, "sides sides"]
    linearised_loss: Float[Array, " paths"] | None
    operating_point: Float[Array, " sides"]
    switched: Float[Array, "links modes"] | None = None
    linearised_change: Float[Array, " links"] | None = None

    def amplitudes(self, deviation: Float[Array, " nodes"]) -> Float[Array, " modes"]:
        """The amplitudes of the modes for given temperatures: the inverse of the shapes is shapes^T
        C."""
        return self.shapes.T @ (self.capacitance * deviation)


def network_modes(
    system: System, duty: Float[Array, " cells"] | None, reference: Float[Array, ""]
) -> Modes:
    """Solves the eigenproblem of a network; gradients do not pass through it.

    **Arguments:**

    - `duty`: the duty at which the cells are linearised, -1 to 1; None for cells that are off, with
      everything at the reference.
    - `reference`: the temperature from which deviations are counted, K.
    """
    system, duty, reference = jax.lax.stop_gradient((system, duty, reference))
    sides = side_nodes(system)
    if duty is None:
        duty = jnp.zeros(len(system.wiring.cold), system.capacitance.dtype)
        at = jnp.zeros_like(system.capacitance)
    else:
        resistance = solve_definite(system.conductance, jnp.eye(system.capacitance.size)[:, sides])
        at = operating_point(system, duty, reference, resistance)
    point = linearise(system, duty, reference, at)
    conductance = system.conductance.at[np.ix_(sides, sides)].add(point.conductance)
    paths = system.wiring.loss_paths
    if point.loss is not None and paths is not None:
        (rows, columns), values = paths.conductance_matrix(point.loss)
        conductance = conductance.at[rows, columns].add(values)
    effects, change = system.wiring.input_wiring, system.conductance_change
    if effects is not None and change is not None:
        conductance = conductance + (effects.differences.T * change) @ effects.differences
    scale = 1 / jnp.sqrt(system.capacitance)
    rates, vectors = eigh(conductance * scale[:, None] * scale[None, :])
    shapes = scale[:, None] * vectors
    return Modes(
        rates=rates,
        shapes=shapes,
        sides=shapes[sides],
        losses=loss_shapes(system, shapes),
        capacitance=system.capacitance,
        linearised_conductance=point.conductance,
        linearised_loss=point.loss,
        operating_point=point.sides,
        switched=None if effects is None else effects.differences @ shapes,
        linearised_change=change,
    )


@final
class Linearisation(eqx.Module):
    """Cells and losses, linearised at a steady state.

    - `sides`: the deviations of the cells' sides, K.
    - `conductance`, `loss`: `linearised_conductance` and `linearised_loss` of `Modes`, W/K.
    """

    sides: Float[Array, " sides"]
    conductance: Float[Array, "sides sides"]
    loss: Float[Array, " paths"] | None


def side_nodes(system: System) -> np.ndarray:
    """The nodes of the cells' sides: all cold ones, then all hot ones."""
    return np.concatenate([system.wiring.cold, system.wiring.hot])


def linearise(
    system: System,
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
    at: Float[Array, " nodes"],
) -> Linearisation:
    """Linearises the cells and losses under a duty, -1 to 1.

    **Arguments:**

    - `reference`: the temperature from which deviations are counted, K.
    - `at`: the deviations of the nodes at which they are linearised, K.
    """
    sides = side_nodes(system)
    slope = heat_slope(system, at[sides], duty, reference)
    loss = None
    if system.loss is not None:
        loss = system.loss.slope(*system.loss_ends(at, reference))
    return Linearisation(at[sides], -(slope + slope.T) / 2, loss)


def run_modes(system: System, inputs: InputSummary) -> Modes:
    """The modes with the cells at their operating point under the run's mean duty cycle.

    Their rates, and therefore all results, are NaN if float64 cannot resolve the slow rates beside
    the fast rates of the network: see `_resolution`.

    **Arguments:**

    - `system`: the equations.
    - `inputs`: the commanded duty cycles and the duration.

    **Returns:** the modes; those of each of the inputs' regimes, with a leading axis, for a rig
    with inputs besides the duty.
    """
    dtype = system.capacitance.dtype
    duty = jnp.asarray(inputs.mean, dtype)

    def modes_of(system: System) -> Modes:
        modes = network_modes(system, duty, reference_temperature(system, inputs))
        span = network_span(system, modes.rates[0], jnp.asarray(inputs.duration, dtype))
        is_resolved = span <= MAX_SPAN
        rates = jnp.where(is_resolved, modes.rates, jnp.nan)
        return eqx.tree_at(lambda modes: modes.rates, modes, rates)

    if inputs.regimes is None:
        return modes_of(system)
    levels = jnp.asarray(inputs.regimes, dtype)
    return jax.vmap(lambda regime: modes_of(system.under(system.conditions(regime))))(levels)


def operating_point(
    system: System,
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
    resistance: Float[Array, "nodes sides"],
) -> Float[Array, " nodes"]:
    """The approximate steady state under a duty: deviations of the nodes, K.

    `resistance` are the network's thermal resistances between nodes and cells' sides, K/W. The
    state is found by Newton's method for the cells' sides, x = Z q(x), where Z are the network's
    thermal resistances between them. An error of a few kelvin does not matter; losses are linear.
    """
    sides = side_nodes(system)
    side_resistance = resistance[sides]
    unit = jnp.eye(sides.size, dtype=side_resistance.dtype)
    lowest, highest = (bound - reference for bound in BELIEVABLE)
    direct = eliminate if sides.size <= FEW_SIDES else solve

    def newton(_: Int[Array, ""], at: Float[Array, " sides"]) -> Float[Array, " sides"]:
        slope = heat_slope(system, at, duty, reference)
        change = at - side_resistance @ side_heat(system, at, duty, reference)
        return jnp.clip(at - direct(unit - side_resistance @ slope, change), lowest, highest)

    start = jnp.full(sides.size, TYPICAL_TEMPERATURE, side_resistance.dtype) - reference
    at = jax.lax.fori_loop(0, NEWTON_STEPS, newton, start)
    return jnp.clip(resistance @ side_heat(system, at, duty, reference), lowest, highest)


def side_heat(
    system: System,
    at: Float[Array, " sides"],
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
) -> Float[Array, " sides"]:
    """The heat flow of the cells into their sides at these deviations, W."""
    flows = system.cell_heat(at + reference, duty)
    return jnp.concatenate([-flows.cold, flows.hot])


def heat_slope(
    system: System,
    at: Float[Array, " sides"],
    duty: Float[Array, " cells"],
    reference: Float[Array, ""],
) -> Float[Array, "sides sides"]:
    """The derivative of `side_heat` with respect to the deviations, W/K."""
    return jax.jacfwd(lambda at: side_heat(system, at, duty, reference))(at)
