r"""The solver: exponential time differencing in the modes of the thermal network.

A rig is linear but for its few thermoelectric nodes:

$$C \dot x = -G x + q(x, u).$$

With the modes $V$ of the network ($V^T C V = 1$, $V^T G V = \Lambda$, one symmetric eigenproblem
a draw) and $x = V z$,

$$\dot z = -\Lambda z + V^T q(V z, u),$$

whose linear part is integrated exactly, however stiff, and whose nonlinear part acts through the
few rows of $V$ that belong to the cells.
Each step is ETDRK4 (Cox and Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. 26-29); its
functions of $\Lambda h$ are elementwise here.

A shorted cell conducts heat through its Seebeck voltage ($\alpha^2 T / R$, several W/K): that part
moves from $q$ to $G$, so that what is left is not stiff and steps of seconds do.

Derivatives do not pass through the eigenvectors, whose derivative does not exist where
eigenvalues repeat, as they do on every symmetric plate.
The basis is held fixed and the change of $G$ and $C$ acts as one more force, which is exact for
the equations and leaves the values alone.
"""

import math
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics import System
from ._schedule import Schedule

TYPICAL_TEMPERATURE = 330.0
"""Of a cell's sides, K: where the conductance of the Seebeck voltage is taken; any will do."""


@final
class Modes(eqx.Module):
    """Modes of the network: `rates` (1/s) and `shapes`, temperatures = shapes @ amplitudes.

    `capacitance` is what the shapes are normalised with; `relief` the conductance moved from the
    cells into the network, W/K.
    """

    rates: Float[Array, " modes"]
    shapes: Float[Array, "nodes modes"]
    capacitance: Float[Array, " nodes"]
    relief: Float[Array, " cells"]

    def amplitudes(self, deviation: Float[Array, " nodes"]) -> Float[Array, " modes"]:
        """The modes' parts in given temperatures: the inverse of the shapes is shapes^T C."""
        return self.shapes.T @ (self.capacitance * deviation)


@final
class Inputs(eqx.Module):
    """What drives the rig during a step: duty cycles and the ambient's deviation, K."""

    duty: Float[Array, " cells"]
    ambient: Float[Array, ""]


def network_modes(system: System) -> Modes:
    """Solves the eigenproblem of a network; gradients do not pass through it."""
    capacitance, conductance, module, bridge = jax.lax.stop_gradient(
        (system.capacitance, system.conductance, system.module, system.bridge)
    )
    cold, hot = system.wiring.cold, system.wiring.hot
    relief = bridge.back_emf_conductance(module, TYPICAL_TEMPERATURE)
    conductance = (
        conductance.at[cold, cold]
        .add(relief)
        .at[hot, hot]
        .add(relief)
        .at[cold, hot]
        .add(-relief)
        .at[hot, cold]
        .add(-relief)
    )
    scale = 1 / jnp.sqrt(capacitance)
    rates, vectors = jnp.linalg.eigh(conductance * scale[:, None] * scale[None, :])
    return Modes(rates, scale[:, None] * vectors, capacitance, relief)


@eqx.filter_custom_jvp
def forcing(
    amplitudes: Float[Array, " modes"],
    system: System,
    modes: Modes,
    inputs: Inputs,
    reference: Float[Array, ""],
) -> Float[Array, " modes"]:
    """What the modes feel beside their own decay: cells and a changing ambient, K/s."""
    wiring = system.wiring
    sides = np.concatenate([wiring.cold, wiring.hot])
    shapes = modes.shapes[sides]
    deviation = shapes @ amplitudes
    heat = system.cell_heat(deviation + reference, inputs.duty)
    cold, hot = jnp.split(deviation, 2)
    relief = modes.relief * (hot - cold)
    force = shapes.T @ jnp.concatenate([-heat.cold - relief, heat.hot + relief])
    return force + modes.shapes.T @ (system.ambient_conductance * inputs.ambient)


@forcing.def_jvp
def _forcing_jvp(primals: Any, tangents: Any) -> Any:
    amplitudes, system, modes, inputs, reference = primals
    d_amplitudes, d_system, _, d_inputs, d_reference = tangents
    value = forcing(*primals)

    def heat(
        deviation: Array, system: System, inputs: Inputs, reference: Array
    ) -> Float[Array, " nodes"]:
        return system.heat_into_nodes(deviation, inputs.duty, reference, inputs.ambient)

    # Modes are the fixed basis of x = V z. V^T q + (V^T G V) z = V^T C x' + rates z, and where C
    # moves away from the value that made V, C x' goes with the old C: V^T (C0 / C) heat.
    d_deviation = None if d_amplitudes is None else modes.shapes @ d_amplitudes
    deviation = modes.shapes @ amplitudes
    flow, d_flow = eqx.filter_jvp(
        heat,
        (deviation, system, inputs, reference),
        (d_deviation, d_system, d_inputs, d_reference),
    )
    if d_system is not None and d_system.capacitance is not None:
        d_flow = d_flow - d_system.capacitance / system.capacitance * flow
    tangent = modes.shapes.T @ d_flow
    if d_amplitudes is not None:
        tangent = tangent + modes.rates * d_amplitudes
    return value, tangent


@final
class StepFactors(eqx.Module):
    """Elementwise factors of one ETDRK4 step: functions of rate times step size."""

    half_decay: Float[Array, "*sizes modes"]
    half: Float[Array, "*sizes modes"]
    decay: Float[Array, "*sizes modes"]
    first: Float[Array, "*sizes modes"]
    middle: Float[Array, "*sizes modes"]
    last: Float[Array, "*sizes modes"]


def step_factors(rates: Float[Array, " modes"], sizes: Float[Array, "*sizes"]) -> StepFactors:
    """The factors for one or several step sizes."""
    h = jnp.asarray(sizes, rates.dtype)[..., None]
    decay, phi1, phi2, phi3 = _phi(rates * h)
    half_decay, half_phi1, _, _ = _phi(rates * h / 2)
    return StepFactors(
        half_decay=half_decay,
        half=h / 2 * half_phi1,
        decay=decay,
        first=h * (phi1 - 3 * phi2 + 4 * phi3),
        middle=h * (2 * phi2 - 4 * phi3),
        last=h * (4 * phi3 - phi2),
    )


def exponential_step(
    amplitudes: Float[Array, " modes"],
    factors: StepFactors,
    system: System,
    modes: Modes,
    inputs: Inputs,
    reference: Float[Array, ""],
) -> tuple[Float[Array, " modes"], Float[Array, " modes"], Float[Array, " modes"]]:
    """One ETDRK4 step.

    **Returns:** the amplitudes at its end, and their slopes at its start and its end.
    """

    def force(z: Float[Array, " modes"]) -> Float[Array, " modes"]:
        return forcing(z, system, modes, inputs, reference)

    decayed = factors.half_decay * amplitudes
    force_0 = force(amplitudes)
    a = decayed + factors.half * force_0
    force_a = force(a)
    b = decayed + factors.half * force_a
    force_b = force(b)
    c = factors.half_decay * a + factors.half * (2 * force_b - force_0)
    force_c = force(c)
    end = (
        factors.decay * amplitudes
        + factors.first * force_0
        + factors.middle * (force_a + force_b)
        + factors.last * force_c
    )
    return end, force_0 - modes.rates * amplitudes, force(end) - modes.rates * end


def solve_schedule(
    system: System,
    schedule: Schedule,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    modes: Modes | None = None,
) -> Float[Array, "times outputs"]:
    """Runs a network through a schedule.

    **Arguments:**

    - `system`: the equations.
    - `schedule`: steps, inputs and samples.
    - `initial`: absolute node temperatures at the start, K.
    - `readout`: which weighted sums of node temperatures to return.
    - `modes`: of the system, where they are known already.

    **Returns:** the sums of the nodes' deviations from the reference at each sample, K.
    The reference is `reference_temperature(system, schedule)`.
    """
    dtype = system.capacitance.dtype
    reference = reference_temperature(system, schedule)
    modes = network_modes(system) if modes is None else modes
    start = modes.amplitudes(initial - reference)
    factors = step_factors(modes.rates, jnp.asarray(schedule.sizes, dtype))
    read = jnp.asarray(readout, dtype) @ modes.shapes
    duty = jnp.asarray(schedule.duty, dtype)
    if schedule.ambient is None:
        ambient = jnp.zeros(duty.shape[0], dtype)
    else:
        ambient = jnp.asarray(schedule.ambient, dtype) - reference

    def advance(amplitudes: Array, step: tuple[Array, Array, Array]) -> tuple[Array, Any]:
        size, duty, ambient = step
        of_size = jax.tree.map(lambda table: table[size], factors)
        inputs = Inputs(duty, ambient)
        end, slope_0, slope_1 = exponential_step(
            amplitudes, of_size, system, modes, inputs, reference
        )
        return end, (read @ end, read @ slope_0, read @ slope_1)

    steps = (jnp.asarray(schedule.size), duty, ambient)
    _, (ends, slopes_0, slopes_1) = jax.lax.scan(advance, start, steps)
    starts = jnp.concatenate([(read @ start)[None], ends[:-1]])
    w = jnp.asarray(schedule.weights, dtype)[..., None]
    at = jnp.asarray(schedule.step_of)
    return (
        w[:, 0] * starts[at] + w[:, 1] * slopes_0[at] + w[:, 2] * ends[at] + w[:, 3] * slopes_1[at]
    )


def reference_temperature(system: System, schedule: Schedule) -> Float[Array, ""]:
    """What deviations are counted from: the ambient at the start, recorded or the rig's, K."""
    if schedule.ambient is None:
        return system.ambient_temperature
    return jnp.asarray(schedule.ambient[0], system.capacitance.dtype)


def _phi(x: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], ...]:
    r"""$e^{-x}$ and $\varphi_k(-x)$, $k = 1, 2, 3$, for $x \ge 0$.

    $\varphi_{k+1}(y) = (\varphi_k(y) - 1/k!) / y$ cancels for small arguments: a series there.
    """
    small = x < 0.3
    tiny, large = jnp.where(small, x, 0.0), jnp.where(small, 1.0, x)
    phi1 = -jnp.expm1(-large) / large
    phi2 = (1 - phi1) / large
    phi3 = (0.5 - phi2) / large

    def series(k: int) -> Array:
        total = jnp.zeros_like(x)
        for power in reversed(range(10)):
            total = total * -tiny + 1 / math.factorial(power + k)
        return total

    return (
        jnp.exp(-x),
        jnp.where(small, series(1), phi1),
        jnp.where(small, series(2), phi2),
        jnp.where(small, series(3), phi3),
    )
