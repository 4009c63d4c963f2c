"""A closed loop as a pure JAX function of twin, controller and scenario."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, PyTree

from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit
from ..._jax_settings import in_precision
from ...physics import Twin
from ...simulation import ModalState, Stepper, SupplyPower, advance, node_temperatures, to_modal
from ..controllers._controller import AbstractController, DutyLimits
from ._measures import ClosedLoop
from ._references import references_ahead
from ._scenario import Scenario

# Electrical power and energy of steps of equal size.
#
# The rule is that of `simulation/_power.py` for runs: Simpson's between the times at which a
# command arrives, with the temperatures of the sides linear in between. Here these times are
# the same in each step, so that they need not be searched for.


def drawn_in_steps(
    stepper: Stepper,
    commands: Float[Array, "times cells"],
    followed: Float[Array, "times cells"],
    sides: tuple[Float[Array, "times cells"], Float[Array, "times cells"]],
) -> SupplyPower:
    """Computes the power and the energy that the bridges draw from the supply while a stepper
    steps, from rest with the cells off.

    **Arguments:**

    - `commands`: the commands that are held from each time on, -1 to 1.
    - `followed`: the duty behind the driver's delay and lag at each time. Without a lag there is no
      delay either, and the commands are used.
    - `sides`: the temperatures of the cells' cold and hot sides at each time; absolute, K.

    **Returns:** power, energy and peak. The peak is searched for at the beginning, in the middle
    and at the end between two arrivals of a command: behind a lag the duty is largest when the next
    command arrives, which is within a step if the delay is not a multiple of it.
    """
    system, parts = stepper.system, len(stepper.sizes)
    last = len(commands) - 1
    waiting = jnp.zeros((stepper.queue, commands.shape[1]), commands.dtype)
    queued = jnp.concatenate([waiting, commands])

    def arriving(part: int) -> Float[Array, "times cells"]:
        """Returns the command that reaches the lag, or the cells, in a part of each step."""
        if system.delay is None:
            return commands
        first = stepper.queue - stepper.delay_steps - (parts - 1 - part)
        return jax.lax.dynamic_slice_in_dim(queued, first, len(commands))

    def power(duty: Array, at: Float[Array, ""]) -> Float[Array, "steps cells"]:
        """Computes the power in all steps, at a given part of each step."""
        cold, hot = ((1 - at) * side[:-1] + at * side[1:] for side in sides)
        return system.bridge.supply_power(system.module, duty, cold, hot)

    first = commands if system.lag is None else followed
    duty, energy = first[:last], jnp.zeros(last, commands.dtype)
    peak = jnp.array(-jnp.inf, commands.dtype)
    begin = jnp.zeros_like(stepper.sizes[0])
    for part in range(parts):
        size, command = stepper.sizes[part], arriving(part)[:last]
        stages = []
        for place in (0.0, 0.5, 1.0):
            after = command
            if system.lag is not None:
                after = command + (duty - command) * jnp.exp(-place * size / system.lag)
            at = (begin + place * size) / stepper.sizes.sum()
            stages.append(power(after, at).sum(axis=1))
        energy = energy + size * (stages[0] + 4 * stages[1] + stages[2]) / 6
        peak = jnp.maximum(
            peak, jnp.where(size > 0, jnp.stack(stages), -jnp.inf).max(initial=-jnp.inf)
        )
        begin = begin + size
        duty = after
    return SupplyPower(
        power=system.bridge.supply_power(system.module, first, *sides),
        energy=jnp.concatenate([jnp.zeros(1, energy.dtype), jnp.cumsum(energy)]),
        peak=peak,
    )


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
    stepper = Stepper(twin, scenario.step, longest_delay=scenario.longest_delay)
    return run_loop(stepper, controller.for_rig(twin.rig), scenario)


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
    controller, scenario = in_precision((controller, scenario), stepper.reference.dtype)
    loss_dtype = jnp.float32 if single_precision_losses else None
    loop = _Loop(stepper, controller, scenario, _readings(stepper, scenario), loss_dtype)
    inputs = _SampleInputs(
        references_ahead(jnp.asarray(scenario.reference), controller.preview_samples),
        scenario.error,
        scenario.arrives,
        scenario.silence,
        _StepInputs(jnp.asarray(scenario.ambient), scenario.heat, scenario.conductance),
    )
    _, recorded = jax.lax.scan(loop.sample, loop.start(), inputs)
    return _signals(stepper, scenario, recorded, controller.limits)


class _StepInputs(NamedTuple):
    """The inputs of the plant in a step, besides the duty: the ambient temperature, degC, and the
    heat, W, and the additional conductance, W/K, of disturbances."""

    ambient: Float[Array, "*substeps"]
    heat: Float[Array | np.ndarray, "*substeps nodes"] | None
    conductance: Float[Array | np.ndarray, "*substeps nodes"] | None


class _SampleInputs(NamedTuple):
    """The part of a scenario that belongs to one sample: references, errors of the readings,
    whether the reading arrives, the longest time without one since the sample before, s, and the
    inputs of the plant in each step until the next sample."""

    reference: Float[Array | np.ndarray, "*preview outputs"]
    error: Float[Array | np.ndarray, " channels"]
    arrives: Bool[Array | np.ndarray, ""]
    silence: Float[Array | np.ndarray, ""]
    steps: _StepInputs


class _LoopState(NamedTuple):
    """The state of a loop between two samples.

    - `measurement`: the last measurement that the controller got, degC.
    - `is_off`: whether the cells have been switched off for good.
    - `late`: readings on their way through their delay, the newest first.
    """

    plant: ModalState
    controller: PyTree
    measurement: Float[Array, " readings"]
    is_off: Bool[Array, ""]
    late: Float[Array, "delay readings"]


class _Recorded(NamedTuple):
    """The signals of a sample that are recorded: the amplitudes of the modes and the duty behind
    the driver at the start of each step, and the duty and the measurement of the sample."""

    amplitudes: Float[Array, "substeps modes"]
    followed: Float[Array, "substeps cells"]
    duty: Float[Array, " cells"]
    measurement: Float[Array, " readings"]


class _Readings(NamedTuple):
    """What the controller reads as linear functions of the modes' amplitudes and of the ambient
    temperature, so that the channels need not be computed at each sample.

    - `weights`: the weights of the channels in each reading.
    - `by_modes`, `by_ambient`: the coefficients of the amplitudes and of the ambient temperature.
    - `celsius`: the temperature from which deviations are counted, degC.
    """

    weights: Float[Array, "readings channels"]
    by_modes: Float[Array, "readings modes"]
    by_ambient: Float[Array, " readings"]
    celsius: Float[Array, ""]

    def at(self, plant: ModalState, ambient: Float[Array, ""]) -> Float[Array, " readings"]:
        """Computes the readings, degC."""
        rest = self.by_ambient * (ambient - self.celsius) + self.weights.sum(axis=1) * self.celsius
        return self.by_modes @ plant.amplitudes + rest


def _readings(stepper: Stepper, scenario: Scenario) -> _Readings:
    system, celsius = stepper.system, stepper.reference - ZERO_CELSIUS
    weights = jnp.asarray(scenario.reading_weights)
    by_nodes, by_ambient = system.output_matrices()
    by_modes = weights @ by_nodes @ stepper.field.modes.shapes
    return _Readings(weights, by_modes, weights @ by_ambient, celsius)


class _Loop(NamedTuple):
    """The parts of a loop that do not change while it runs.

    - `loss_dtype`: the precision of the nonlinear losses; None for that of the stepper.
    """

    stepper: Stepper
    controller: AbstractController
    scenario: Scenario
    readings: _Readings
    loss_dtype: DTypeLike | None

    def start(self) -> _LoopState:
        """Returns the state of the loop before its first sample, with the cells off."""
        stepper, scenario = self.stepper, self.scenario
        dtype = stepper.reference.dtype
        idle = jnp.zeros(len(stepper.system.wiring.cold), dtype)
        plant = to_modal(stepper, stepper.start(scenario.initial, idle))
        first = self.readings.at(plant, jnp.asarray(scenario.ambient)[0, 0])
        error = jnp.nan_to_num(jnp.asarray(scenario.error)[0])
        measurement = first + self.readings.weights @ error
        return _LoopState(
            plant,
            self.controller.init(idle, self._with_room(measurement, scenario.ambient[0, 0])),
            measurement,
            jnp.zeros((), bool),
            jnp.broadcast_to(first, (scenario.sensor_delay_steps, len(first))),
        )

    def sample(self, state: _LoopState, inputs: _SampleInputs) -> tuple[_LoopState, _Recorded]:
        """Reads the plant, computes the duty, and steps the plant to the next sample."""
        stepper, controller, scenario = self.stepper, self.controller, self.scenario
        read = self._read(state, inputs)
        measurement = self._with_room(read.measurement, inputs.steps.ambient[0])
        asked, following = controller.step(state.controller, inputs.reference, measurement)
        duty = _applied(scenario, stepper.system.wiring.lowest_duty, asked, read.is_off)

        def step(
            carry: tuple[ModalState, Array], steps: _StepInputs
        ) -> tuple[tuple[ModalState, Array], tuple[Array, Array]]:
            (plant, late), ambient, heat = carry, steps.ambient, None
            if steps.heat is not None and steps.conductance is not None:
                rise = node_temperatures(stepper, plant) - ambient
                heat = jnp.asarray(steps.heat) - steps.conductance * rise
            if scenario.sensor_delay_steps:
                late = jnp.concatenate([self.readings.at(plant, ambient)[None], late[:-1]])
            later = advance(stepper, plant, duty, ambient, heat, loss_dtype=self.loss_dtype)
            return (later, late), (plant.amplitudes, plant.duty)

        carry = state.plant, state.late
        if len(inputs.steps.ambient) == 1:  # a single step needs no inner scan
            carry, kept = step(carry, jax.tree.map(lambda row: row[0], inputs.steps))
        else:
            carry, kept = jax.lax.scan(step, carry, inputs.steps)
        plant, late = carry
        later = read._replace(plant=plant, controller=following, late=late)
        return later, _Recorded(*kept, duty, read.measurement)

    def _with_room(
        self, measurement: Float[Array, " readings"], ambient: Float[Array, ""]
    ) -> Float[Array, "..."]:
        """Returns the measurement with the room at its end, for a controller that reads it."""
        if not self.controller.reads_room:
            return measurement
        return jnp.append(measurement, ambient if self.scenario.room_is_measured else jnp.nan)

    def _read(self, state: _LoopState, inputs: _SampleInputs) -> _LoopState:
        """Returns the state with a new measurement, or with the last one if no reading arrives."""
        if self.scenario.sensor_delay_steps:
            true = state.late[-1]
        else:
            true = self.readings.at(state.plant, inputs.steps.ambient[0])
        reading = true + self.readings.weights @ inputs.error
        is_finite = jnp.all(jnp.isfinite(inputs.error)) & jnp.all(jnp.isfinite(reading))
        is_new = inputs.arrives & is_finite
        return state._replace(
            measurement=jnp.where(is_new, reading, state.measurement),
            is_off=state.is_off | (inputs.silence > self.scenario.silence_limit),
        )


def _applied(
    scenario: Scenario,
    lowest: Float[np.ndarray, " cells"],
    asked: Float[Array, " cells"],
    is_off: Bool[Array, ""],
) -> Float[Array, " cells"]:
    """Returns the duty that the driver gets: clipped, rounded to counts, and 0 once the cells are
    off."""
    duty = jnp.where(is_off, 0.0, jnp.clip(asked, jnp.asarray(lowest, asked.dtype), 1.0))
    if scenario.counts is None:
        return duty
    rounded = jnp.round(duty * scenario.counts) / scenario.counts
    return duty + jax.lax.stop_gradient(rounded - duty)


def _signals(
    stepper: Stepper, scenario: Scenario, recorded: _Recorded, limits: DutyLimits
) -> ClosedLoop:
    """Computes the signals at every step of the plant. Those that the controller does not need are
    computed here for all steps at once, which takes less time than in the loop."""
    system, wiring = stepper.system, stepper.system.wiring
    ambient = jnp.asarray(scenario.ambient)
    substeps = ambient.shape[1]
    count = (len(scenario.time) - 1) * substeps + 1

    def of_steps(values: Array) -> Array:
        return values.reshape(-1, values.shape[-1])[:count]

    def of_samples(values: Array) -> Array:
        return jnp.repeat(values, substeps, axis=0)[:count]

    celsius = stepper.reference - ZERO_CELSIUS
    deviation = of_steps(recorded.amplitudes) @ stepper.field.modes.shapes.T
    room = ambient.reshape(-1, 1)[:count] - celsius
    temperatures = system.channel_temperatures(deviation, room) + celsius
    absolute = deviation + stepper.reference
    sides = absolute[:, wiring.cold], absolute[:, wiring.hot]
    duty = of_samples(recorded.duty)
    drawn = drawn_in_steps(stepper, duty, of_steps(recorded.followed), sides)
    return ClosedLoop(
        time=scenario.step * jnp.arange(count, dtype=celsius.dtype),
        reference=of_samples(jnp.asarray(scenario.reference)),
        output=temperatures @ jnp.asarray(scenario.output_weights).T,
        measurement=of_samples(recorded.measurement),
        temperatures=temperatures,
        nodes=deviation + celsius,
        duty=duty,
        power=drawn.power,
        energy=drawn.energy,
        peak_power=drawn.peak,
        limits=limits,
        elements=wiring.elements,
        sides=tuple(int(side) for side in np.concatenate([wiring.cold, wiring.hot])),
    )
