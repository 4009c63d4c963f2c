"""A closed loop as a pure JAX function of twin, controller and scenario."""

from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, PyTree

from .._compilation import persistent_jit
from ..physics import Twin
from ..simulation import Stepper
from ..simulation._stepper import (
    ZERO_CELSIUS,
    ModalState,
    advance,
    node_temperatures,
    to_modal,
)
from ._controller import AbstractController
from ._drawn_power import drawn_in_steps
from ._references import references_ahead
from ._scenario import Scenario


@final
class ClosedLoop(eqx.Module):
    """The signals of a closed loop at every step of the plant, from which measures are computed.

    **Arguments:**

    - `time`: s.
    - `reference`, `output`: reference and true value of the controlled temperatures, degC.
    - `measurement`: the controlled temperatures as the controller gets them, with noise, delay and
      lost messages, degC.
    - `temperatures`: of the channels, without noise, degC.
    - `nodes`: of the twin's nodes, degC.
    - `duty`: the duty commanded from this time on, -1 to 1.
    - `power`: the power that each cell's bridge draws from the supply, W.
    - `energy`: what all bridges together have drawn from the supply up to this time, J.
    - `peak_power`: the largest power of all bridges together at any time, also within steps, W.
    - `elements`: the number of elements of the plate, which are the first nodes.
    - `sides`: the nodes that are sides of the cells.
    """

    time: Float[Array | np.ndarray, "*draws times"]
    reference: Float[Array | np.ndarray, "*draws times outputs"]
    output: Float[Array | np.ndarray, "*draws times outputs"]
    measurement: Float[Array | np.ndarray, "*draws times outputs"]
    temperatures: Float[Array | np.ndarray, "*draws times channels"]
    nodes: Float[Array | np.ndarray, "*draws times nodes"]
    duty: Float[Array | np.ndarray, "*draws times cells"]
    power: Float[Array | np.ndarray, "*draws times cells"]
    energy: Float[Array | np.ndarray, "*draws times"]
    peak_power: Float[Array | np.ndarray, "*draws"]
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
        """Whether a single loop has finite temperatures at its end and a finite duty always."""
        return jnp.all(jnp.isfinite(self.nodes[-1])) & jnp.all(jnp.isfinite(self.duty))


class _Loop(NamedTuple):
    """The state of a loop between two samples."""

    plant: ModalState
    controller: PyTree
    measurement: Float[Array, " outputs"]
    missing_s: Float[Array, ""]
    is_off: Bool[Array, ""]
    late: Float[Array, "delay outputs"]


def closed_loop(twin: Twin, controller: AbstractController, scenario: Scenario) -> ClosedLoop:
    """Runs a controller on a twin. This is a pure JAX function of both, and of the scenario.

    It can be used inside `jax.jit`, `jax.vmap`, `jax.jacfwd` or `jax.grad`; `simulate_closed_loop`
    adds checks and labels. The precision is the one that JAX is set to: use `jax.enable_x64(True)`
    for float64. Derivatives ignore the rounding of the duty to counts.

    **Arguments:**

    - `twin`: rig and parameters.
    - `controller`: a controller with the outputs for which the scenario was made.
    - `scenario`: references, initial state, disturbances and errors of the readings.
    """
    stepper = Stepper(twin, scenario.step_s, longest_delay=scenario.longest_delay_s)
    return run_loop(stepper, controller, scenario)


@persistent_jit
def run_loop(
    stepper: Stepper,
    controller: AbstractController,
    scenario: Scenario,
    single_precision_losses: bool = False,
) -> ClosedLoop:
    """Runs a controller on a stepper, in the precision of the stepper.

    **Arguments:**

    - `single_precision_losses`: whether the nonlinear losses of the plate are computed in float32.
    """
    dtype = stepper.reference.dtype
    controller, scenario = in_precision((controller, scenario), dtype)
    system, wiring = stepper.system, stepper.system.wiring
    cells, channels = len(wiring.cold), len(wiring.channels)
    loss_dtype = jnp.float32 if single_precision_losses else None
    weights = jnp.asarray(scenario.output_weights)
    interval = controller.sample_time_s

    gain = jnp.broadcast_to(system.gain, (channels,))[:, None]
    shapes, celsius = stepper.field.modes.shapes, stepper.reference - ZERO_CELSIUS
    # The controller's outputs by the modes, and by the ambient: no channel is read on the way.
    seen_by_modes = weights @ (gain * jnp.asarray(system.channel_weights, dtype)) @ shapes
    seen_by_ambient = weights @ (1 - gain[:, 0] * system.on_plate)

    def outputs(plant: ModalState, ambient: Array) -> Array:
        rest = seen_by_ambient * (ambient - celsius) + weights.sum(axis=1) * celsius
        return seen_by_modes @ plant.amplitudes + rest

    def sample(loop: _Loop, row: Any) -> tuple[_Loop, Any]:
        reference, ambient, heat, conductance, error, arrives = row
        then = loop.late[-1] if scenario.sensor_delay_steps else outputs(loop.plant, ambient[0])
        output = then + weights @ error
        is_new = arrives & jnp.all(jnp.isfinite(error)) & jnp.all(jnp.isfinite(output))
        measurement = jnp.where(is_new, output, loop.measurement)
        missing = jnp.where(is_new, 0.0, loop.missing_s + interval).astype(dtype)
        is_off = loop.is_off | (missing > scenario.silence_s)
        asked, state = controller.step(loop.controller, reference, measurement)
        duty = jnp.where(is_off, 0.0, jnp.clip(asked, -1.0, 1.0))
        if scenario.counts is not None:
            rounded = jnp.round(duty * scenario.counts) / scenario.counts
            duty = duty + jax.lax.stop_gradient(rounded - duty)

        def step(carry: tuple[ModalState, Array], row: Any) -> tuple[Any, Any]:
            (plant, late), (ambient, heat, conductance) = carry, row
            if conductance is not None:
                heat = heat - conductance * (node_temperatures(stepper, plant) - ambient)
            if scenario.sensor_delay_steps:
                late = jnp.concatenate([outputs(plant, ambient)[None], late[:-1]])
            later = advance(stepper, plant, duty, ambient, heat, loss_dtype)
            return (later, late), (plant.amplitudes, plant.duty)

        steps = ambient, heat, conductance
        if len(ambient) == 1:  # without a loop in the loop
            first = jax.tree.map(lambda row: row[0], steps)
            carry, found = step((loop.plant, loop.late), first)
        else:
            carry, found = jax.lax.scan(step, (loop.plant, loop.late), steps)
        later = _Loop(carry[0], state, measurement, missing, is_off, carry[1])
        return later, (*found, duty, measurement)

    idle = jnp.zeros(cells, dtype)
    ambient = jnp.asarray(scenario.ambient)
    plant = to_modal(stepper, stepper.start(scenario.initial, idle))
    first = outputs(plant, ambient[0, 0])
    measurement = first + weights @ jnp.nan_to_num(jnp.asarray(scenario.error)[0])
    start = _Loop(
        plant,
        controller.init(idle, measurement),
        measurement,
        jnp.zeros((), dtype),
        jnp.zeros((), bool),
        jnp.broadcast_to(first, (scenario.sensor_delay_steps, len(first))),
    )
    rows = (
        references_ahead(jnp.asarray(scenario.reference), controller.preview_samples),
        ambient,
        scenario.heat,
        scenario.conductance,
        scenario.error,
        scenario.arrives,
    )
    _, (amplitudes, followed, duty, measured) = jax.lax.scan(sample, start, rows)
    substeps = ambient.shape[1]
    count = (len(scenario.time) - 1) * substeps + 1

    def of_steps(values: Array) -> Array:
        return values.reshape(-1, values.shape[-1])[:count]

    def of_samples(values: Array) -> Array:
        return jnp.repeat(values, substeps, axis=0)[:count]

    # Whatever no controller needs is read of all steps at once.
    deviation = of_steps(amplitudes) @ shapes.T
    room = ambient.reshape(-1, 1)[:count] - celsius
    temperatures = system.channel_temperatures(deviation, room) + celsius
    absolute = deviation + stepper.reference
    sides = absolute[:, wiring.cold], absolute[:, wiring.hot]
    drawn = drawn_in_steps(stepper, of_samples(duty), of_steps(followed), sides)
    return ClosedLoop(
        time=scenario.step_s * jnp.arange(count, dtype=dtype),
        reference=of_samples(jnp.asarray(scenario.reference)),
        output=temperatures @ weights.T,
        measurement=of_samples(measured),
        temperatures=temperatures,
        nodes=deviation + celsius,
        duty=of_samples(duty),
        power=drawn.power,
        energy=drawn.energy,
        peak_power=drawn.peak,
        elements=wiring.elements,
        sides=tuple(int(side) for side in np.concatenate([wiring.cold, wiring.hot])),
    )


def in_precision(tree: PyTree, dtype: DTypeLike) -> PyTree:
    """Converts floating-point leaves to a precision."""

    def cast(leaf: Any) -> Any:
        is_floating = eqx.is_array(leaf) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, dtype) if is_floating else leaf

    return jax.tree.map(cast, tree)
