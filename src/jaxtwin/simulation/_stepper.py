"""Steps a twin in time with a rig: for a live twin or a controller by equal steps, and for an
observer, whose readings come at irregular times, by steps of any length."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from .._arguments import finite_number
from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit_unoptimised
from .._jax_settings import in_precision, is_traced, settings_for
from ..errors import SimulationError
from ..physics import Conditions, System, Twin, check_twin
from ._check_values import check_values
from ._exponential import (
    ModalField,
    StepFactors,
    StepInputs,
    exponential_step,
    loss_force,
    step_factors,
)
from ._input_levels import stated_levels
from ._modes import LossShapes
from ._step_preparation import check_stable, is_multiple, prepare_steps, queue_length


@final
class StepperState(eqx.Module):
    """The state of a twin between two steps.

    - `nodes`: temperatures of the nodes, degC, in the order of `twin.netlist.nodes`.
    - `duty`: the duty that reaches the cells, -1 to 1; it follows the command with the driver's
      lag.
    - `commands`: the commands in transit through the driver's delay, -1 to 1, the newest first.
      Without a delay there are none.
    """

    nodes: Float[Array | np.ndarray, " nodes"]
    duty: Float[Array | np.ndarray, " cells"]
    commands: Float[Array | np.ndarray, "delays cells"]

    def __getstate__(self) -> dict[str, Any]:
        """Pickles and copies the numbers as arrays of NumPy, see `Stepper`."""
        return _as_numpy(self)


@final
class ModalState(eqx.Module):
    """A `StepperState` in the modes of the twin, in which many steps in a row are computed."""

    amplitudes: Float[Array, " modes"]
    duty: Float[Array, " cells"]
    commands: Float[Array, "delays cells"]


@final
class Stepper(eqx.Module):
    """Steps a twin, with a command for each step.

    A stepper takes the same exponential steps as `simulate`, all of the same size. The driver's
    delay and lag are exact, whether or not they are multiples of the step size.

    ```python
    stepper = jt.Stepper(jt.Twin("dual-cell"), step_size=1.0)
    state = stepper.start()
    for _ in range(60):
        state = stepper.step(state, [0.5, 0.2])
    stepper.channels(state)  # degC
    ```

    A stepper is a PyTree whose leaves are the numbers in the twin's equations. It can pass through
    `jax.jit`, `jax.vmap` and `jax.grad`, and can be made inside of them. Other values need no new
    compilation. Outside of these transformations the steps are computed in float64. Inside, the
    precision is that of the caller: wrap the call in `jax.enable_x64(True)`.

    The ambient temperature is an input of each step; it does not drift by itself.

    **Arguments:**

    - `twin`: the twin; or its equations, as `twin.system()` makes them.
    - `step_size`: the size of each step, s.
    - `longest_delay`: the longest delay for which the state has room, s. None: the delay of the
      twin. It must be given if the delay is traced by JAX.
    - `is_whole_delay`: whether a delay that is traced by JAX is a multiple of the step size; a step
      then costs half as much.

    **Raises:** `SimulationError` if the step size is not above 0, if steps of this size are not
    stable, if the delay is traced and `longest_delay` is missing, or if the delay is longer than
    `longest_delay`; `ParameterError` if a parameter has more than one value, or if a resistance, a
    heat capacity, a lag or a delay is not above 0.
    """

    system: System
    reference: Float[Array, ""]
    """The temperature from which the modes count, K: the ambient temperature of the rig."""
    delay_steps: Int[Array, ""]
    """The number of whole steps in the driver's delay."""
    sizes: Float[Array, " parts"]
    """The parts of a step, s. With a delay that is not a multiple of the step, these are the part
    before the command of a step arrives and the part after it; otherwise the step is one part."""
    factors: StepFactors
    field: ModalField
    """The vector field in the modes, without the losses that are not linear."""
    losses: LossShapes | None
    """The modes at the paths of heat that is not linear; None if all heat is."""
    half_decay: Float[Array, " modes"]
    half: Float[Array, " modes"]
    """The factors of amplitudes and of forces over half a step."""
    queue: int = eqx.field(static=True)
    """The number of commands that a state holds."""

    def __init__(
        self,
        twin: Twin | System,
        step_size: float | int = 1.0,
        *,
        longest_delay: float | int | None = None,
        is_whole_delay: bool = False,
    ):
        where = "Stepper: step_size"
        size = finite_number(where, step_size, SimulationError, above=0, unit="s")
        if not isinstance(twin, System):
            check_twin("Stepper: twin", twin, SimulationError)
            if not is_traced(twin):
                check_values(twin)
        with settings_for(twin):
            self.system = twin if isinstance(twin, System) else assembled(twin)
            self.reference = jnp.asarray(self.system.ambient_temperature)
            self.queue = queue_length(self.system.delay, size, longest_delay)
            is_whole = is_whole_delay or is_multiple(self.system.delay, size)
            step_size_s = jnp.asarray(size, self.reference.dtype)
            self.delay_steps, self.sizes, steps = prepare_steps(self.system, step_size_s, is_whole)
            self.factors, self.field, self.losses, self.half_decay, self.half, stability = steps
        check_stable("Stepper", size, stability)

    def __getstate__(self) -> dict[str, Any]:
        """Pickles and copies the numbers as arrays of NumPy, because arrays of JAX lose their
        float64 when another process reads them."""
        return _as_numpy(self)

    @property
    def ambient(self) -> Float[Array, ""]:
        """The ambient temperature of the rig, degC: the default of each step."""
        with settings_for(self.reference):
            return jnp.asarray(self.reference) - ZERO_CELSIUS

    def start(
        self,
        nodes: ArrayLike | float | int | None = None,
        duty: ArrayLike | None = None,
    ) -> StepperState:
        """Makes an initial state.

        **Arguments:**

        - `nodes`: temperatures of the nodes, degC, `(nodes,)` or a single one for all; None: the
          initial temperatures of the rig.
        - `duty`: the duty that was commanded before, for a long time, `(cells,)`, -1 to 1; None: 0.
        """
        cells = (len(self.system.wiring.cold),)
        with settings_for(self.reference, nodes, duty):
            if nodes is None:
                nodes = self.system.initial_temperature - ZERO_CELSIUS
            dtype = self.reference.dtype
            held = jnp.broadcast_to(jnp.asarray(0.0 if duty is None else duty, dtype), cells)
            return StepperState(
                jnp.broadcast_to(jnp.asarray(nodes, dtype), self.system.capacitance.shape),
                held,
                jnp.broadcast_to(held, (self.queue, *cells)),
            )

    def step(
        self,
        state: StepperState,
        duty: ArrayLike,
        ambient: ArrayLike | float | int | None = None,
        *,
        steps: ArrayLike | int = 1,
        heat: ArrayLike | None = None,
        inputs: Mapping[str, Any] | None = None,
    ) -> StepperState:
        """Computes the state after one or several steps under a command.

        **Arguments:**

        - `state`: the state at the start of the step.
        - `duty`: the commanded duty during the step, `(cells,)`, -1 to 1.
        - `ambient`: the ambient temperature during the step, degC; None: that of the rig.
        - `steps`: the number of steps under this command, in one compiled call.
        - `heat`: additional heat flows into the nodes during the step, `(nodes,)`, W, such as the
          heat of a hand on the plate; None for none.
        - `inputs`: the rig's other inputs during the step, name -> number or name of a state. Those
          that are not given have the value of the rig file.

        **Raises:** `SimulationError` if the command does not have a number for each cell, or for an
        unknown input or state.
        """
        with settings_for(self.reference, state, duty, ambient, steps, heat):
            stepper, state = _in_precision_of_caller(self, state)
            dtype = stepper.reference.dtype
            command = jnp.asarray(duty, dtype)
            cells = len(self.system.wiring.cold)
            if command.shape != (cells,):
                raise SimulationError(
                    f"Stepper.step: duty: expected {cells} duty cycles, one for each cell, got an "
                    f"array of shape {command.shape}"
                )
            ambient = stepper.ambient if ambient is None else jnp.asarray(ambient, dtype)
            if heat is not None:
                heat = jnp.asarray(heat, dtype)
            conditions = None
            if inputs:
                known = self.system.wiring.inputs
                levels = stated_levels("Stepper.step", known, inputs, SimulationError)
                conditions = stepper.system.conditions(levels)
            held = command, ambient, heat, conditions
            if isinstance(steps, int) and is_traced(self.reference, state, command, ambient):
                # With a Python number of steps the loop has a known length and gradients exist.
                return _take_steps(stepper, state, steps, *held)
            return _steps(stepper, state, jnp.asarray(steps), *held)

    def channels(
        self, state: StepperState, ambient: ArrayLike | float | int | None = None
    ) -> Float[Array, " channels"]:
        """The readings of the channels, degC, at an ambient temperature, degC (None: the rig's)."""
        with settings_for(self.reference, state, ambient):
            stepper, state = _in_precision_of_caller(self, state)
            dtype = stepper.reference.dtype
            ambient = stepper.ambient if ambient is None else jnp.asarray(ambient, dtype)
            return _channels(stepper.system, jnp.asarray(state.nodes, dtype), ambient)


def _in_precision_of_caller(stepper: Stepper, state: StepperState) -> tuple[Stepper, StepperState]:
    """Converts stepper and state to float32 inside a transformation of a caller in float32."""
    is_float64 = jax.config.read("jax_enable_x64")
    return (stepper, state) if is_float64 else in_precision((stepper, state), jnp.float32)


def _as_numpy(module: eqx.Module) -> dict[str, Any]:
    """The fields of a module with arrays of NumPy in place of those of JAX. Other leaves, such as
    the placeholders in a compiled program's output, stay as they are."""
    return vars(
        jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, module)
    ).copy()


@persistent_jit_unoptimised
def assembled(twin: Twin) -> System:
    """The equations of a twin, as a program of its own."""
    return twin.system()


def to_modal(stepper: Stepper, state: StepperState) -> ModalState:
    """Transforms a state to the modes."""
    deviation = jnp.asarray(state.nodes) + ZERO_CELSIUS - stepper.reference
    amplitudes = stepper.field.modes.amplitudes(deviation)
    return ModalState(amplitudes, jnp.asarray(state.duty), jnp.asarray(state.commands))


def node_temperatures(stepper: Stepper, state: ModalState) -> Float[Array, " nodes"]:
    """The temperatures of all nodes, degC."""
    deviation = stepper.field.modes.shapes @ state.amplitudes
    return deviation + stepper.reference - ZERO_CELSIUS


def advance(
    stepper: Stepper,
    state: ModalState,
    command: Float[Array, " cells"],
    ambient: Float[Array, ""],
    heat: Float[Array, " nodes"] | None = None,
    conditions: Conditions | None = None,
    loss_dtype: DTypeLike | None = None,
) -> ModalState:
    """Computes the state after a step under a command; ambient in degC, heat in W.

    **Arguments:**

    - `conditions`: what the rig's other inputs change; None where none is stated.
    - `loss_dtype`: the precision of the losses that are not linear, None for that of the
      state. They are a small part of the heat flows: in float32 they cost a third of what they
      cost in float64, and channels change by microkelvins.
    """
    system, modes = stepper.system, stepper.field.modes
    surroundings = ambient + ZERO_CELSIUS - stepper.reference
    modal_heat = None if heat is None else modes.shapes.T @ heat
    if system.delay is None:
        commands, delayed = state.commands, command[None]
    else:
        commands = jnp.concatenate([command[None], state.commands[:-1]])
        places = stepper.delay_steps + jnp.arange(len(stepper.sizes))[::-1]
        delayed = commands[places]
    amplitudes, duty = state.amplitudes, state.duty
    now = delayed[0] if system.lag is None else duty
    held = StepInputs(now, surroundings, modal_heat, conditions)
    line = loss_trend(stepper, amplitudes, held, loss_dtype)
    begin = jnp.zeros_like(stepper.sizes[0])
    for number in range(len(stepper.sizes)):
        size = stepper.sizes[number]
        factors = jax.tree.map(lambda table, n=number: table[n], stepper.factors)
        times = begin + size * _stages(size)
        flow = modal_heat if line is None else line.first + times[:, None] * line.slope
        inputs, duty = _inputs(system, duty, delayed[number], size, surroundings, flow)
        inputs = replace(inputs, conditions=conditions)
        if line is not None and len(stepper.sizes) == 1:
            force = line.force
        else:
            force = stepper.field.force(amplitudes, inputs.at(0))
        end = exponential_step(amplitudes, force, factors, stepper.field, inputs)
        amplitudes = end.amplitudes
        begin = begin + size
    return ModalState(amplitudes, duty, commands)


class _LossTrend(NamedTuple):
    """The losses that are not linear, within a step and beyond the modes' linear losses, as forces
    on the modes: at the start, with their change per second; and the whole force at the start."""

    first: Float[Array, " modes"]
    slope: Float[Array, " modes"]
    force: Float[Array, " modes"]


def loss_trend(
    stepper: Stepper,
    amplitudes: Float[Array, " modes"],
    held: StepInputs,
    dtype: DTypeLike | None,
) -> _LossTrend | None:
    """Computes the losses that are not linear, beyond the modes' linear losses, with the heat of
    the inputs at the start of the step; None if all losses are linear.

    These losses change by a thousandth in a second, and cost more than all the rest. They are
    therefore computed at the start and in the middle of a step, and interpolated linearly.
    """
    if stepper.losses is None:
        return None

    def force(amplitudes: Array) -> Array:
        lost = losses(stepper, amplitudes, held.ambient, dtype)
        return lost if held.heat is None else lost + held.heat

    first = force(amplitudes)
    begin = stepper.field.force(amplitudes, replace(held, heat=first))
    middle = force(stepper.half_decay * amplitudes + stepper.half * begin)
    return _LossTrend(first, (middle - first) * 2 / stepper.sizes.sum(), begin)


def losses(
    stepper: Stepper,
    amplitudes: Float[Array, " modes"],
    ambient: Float[Array, ""],
    dtype: DTypeLike | None = None,
) -> Float[Array, " modes"]:
    """Computes the losses of the plate beyond the modes' linear losses, as a force; 0 if losses are
    linear."""
    shapes, linearised = stepper.losses, stepper.field.modes.linearised_loss
    if shapes is None or linearised is None:
        return jnp.zeros_like(amplitudes)
    return loss_force(
        shapes, linearised, stepper.system, stepper.reference, amplitudes, ambient, dtype
    )


def _stages(size: Float[Array, ""]) -> Float[Array, " 3"]:
    return jnp.array([0.0, 0.5, 1.0], size.dtype)


def _take_steps(
    stepper: Stepper,
    state: StepperState,
    steps: Int[Array, ""] | int,
    command: Float[Array, " cells"],
    ambient: Float[Array, ""],
    heat: Float[Array, " nodes"] | None,
    conditions: Conditions | None,
) -> StepperState:
    def step(number: Array, state: ModalState) -> ModalState:
        del number
        return advance(stepper, state, command, ambient, heat, conditions)

    end = jax.lax.fori_loop(0, steps, step, to_modal(stepper, state))
    return StepperState(node_temperatures(stepper, end), end.duty, end.commands)


_steps = jax.jit(_take_steps)


def _inputs(
    system: System,
    duty: Float[Array, " cells"],
    command: Float[Array, " cells"],
    size: Float[Array, ""],
    surroundings: Float[Array, ""],
    heat: Float[Array, "*stages modes"] | None,
) -> tuple[StepInputs, Float[Array, " cells"]]:
    """The inputs of a step under a command that has arrived, and the duty at its end."""
    if system.lag is None:
        return StepInputs(command, surroundings, heat), command
    # du/dt = (command - u) / lag, at the start, in the middle and at the end.
    elapsed = size * _stages(size)
    stages = command + (duty - command) * jnp.exp(-elapsed / system.lag)[:, None]
    return StepInputs(stages, surroundings, heat), stages[-1]


@jax.jit
def _channels(
    system: System, nodes: Float[Array, " nodes"], ambient: Float[Array, ""]
) -> Float[Array, " channels"]:
    return ambient + system.channel_temperatures(nodes - ambient)


# A step of any length, by the numbers of a `Stepper`: for an observer, whose readings come at
# irregular times.


def variable_step(
    stepper: Stepper,
    amplitudes: Float[Array, " modes"],
    duty: Float[Array, "stages cells"],
    surroundings: Float[Array, ""],
    heat: Float[Array, " modes"],
    size: Float[Array, ""],
    conditions: Conditions | None = None,
) -> Float[Array, " modes"]:
    """Computes the amplitudes of the modes after a step.

    **Arguments:**

    - `stepper`: gives the modes. Its step size says up to which length steps are stable.
    - `amplitudes`: those at the start of the step.
    - `duty`: the duty that reaches the cells at the start, in the middle and at the end.
    - `surroundings`: the ambient's deviation from the reference during the step, K.
    - `heat`: an additional force on the modes during the step.
    - `size`: the length of the step, s; 0 leaves the amplitudes as they are.
    - `conditions`: what the rig's other inputs change during the step; None where none is stated.
    """
    factors = step_factors(stepper.field.modes.rates, size)
    # The line through the losses divides by the length of the step.
    length = jnp.maximum(size, jnp.finfo(size.dtype).tiny ** 0.5)[None]
    sized = eqx.tree_at(
        lambda s: (s.sizes, s.half_decay, s.half),
        stepper,
        (length, factors.half_decay, factors.half),
    )
    held = StepInputs(duty[0], surroundings, heat, conditions)
    line = loss_trend(sized, amplitudes, held, None)
    flow = heat
    if line is not None:
        elapsed = size * jnp.array([0.0, 0.5, 1.0], size.dtype)
        flow = line.first + elapsed[:, None] * line.slope
    inputs = StepInputs(duty, surroundings, flow, conditions)
    force = stepper.field.force(amplitudes, inputs.at(0)) if line is None else line.force
    return exponential_step(amplitudes, force, factors, stepper.field, inputs).amplitudes


def linear_step(
    matrix: Float[Array, "modes modes"],
    rates: Float[Array, " modes"],
    amplitudes: Float[Array, "modes columns"],
    forces: Float[Array, "stages modes columns"],
    size: Float[Array, ""],
) -> Float[Array, "modes columns"]:
    r"""Computes the amplitudes after a step for forces that are linear in them, of several columns
    side by side: $\dot z = (M - \Lambda) z + f(t)$.

    **Arguments:**

    - `matrix`: $M$. `rates`: the diagonal of $\Lambda$, 1/s.
    - `amplitudes`: those at the start of the step.
    - `forces`: $f$ at the start, in the middle and at the end of the step.
    - `size`: the length of the step, s.
    """
    factors, field = step_factors(rates, size), _LinearField(matrix)

    def column(
        amplitudes: Float[Array, " modes"], forces: Float[Array, "stages modes"]
    ) -> Float[Array, " modes"]:
        # `_LinearField` uses the forces alone: no duty, and the size stands in for an ambient.
        inputs = StepInputs(forces[0, :0], size, forces)
        first = field.force(amplitudes, inputs.at(0))
        return exponential_step(amplitudes, first, factors, field, inputs).amplitudes

    return jax.vmap(column, in_axes=(1, 2), out_axes=1)(amplitudes, forces)


@final
class _LinearField(eqx.Module):
    """Forces that are linear in the amplitudes, and those from outside."""

    matrix: Float[Array, "modes modes"]

    def force(
        self, amplitudes: Float[Array, " modes"], inputs: StepInputs
    ) -> Float[Array, " modes"]:
        assert inputs.heat is not None
        return self.matrix @ amplitudes + inputs.heat
