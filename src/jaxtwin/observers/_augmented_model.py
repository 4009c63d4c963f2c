r"""The twin with the states that its equations do not have: the model of the observer.

The state of the observer is a vector with these parts:

| part | what it is |
|---|---|
| `modes` | amplitudes of the modes of the network, from which all node temperatures follow |
| `duty` | the duty that reaches the cells, if the driver has a lag, -1 to 1 |
| `room` | the room's deviation from the reference, K; a random walk |
| `heats` | disturbance heats into the nodes that the cells heat, W |
| `values` | the twin's uncertain values, as multiples of directions among its parameters |
| `common` | the parts of the error that all channels share, K |
| `channels` | the error of each channel by itself, K |

Heats, the first part of the common error, the errors of channels and the values are forgotten
exponentially and driven by white noise (Ornstein-Uhlenbeck processes). The other parts of the
common error begin at a correction of the camera and decay; nothing drives them between corrections
(`_expected_correction`).

A change of the twin's values enters as a heat: the difference between the right-hand sides with the
changed and with the original values, at the start of a step. The modes therefore stay those of the
original values, and no step needs another eigenproblem. The numbers of the equations are taken as
linear in the multiples of the directions, so that no step assembles a network.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit_unoptimised
from ..physics import Conditions, System, Twin
from ..simulation import StepInputs, Stepper, linear_step, losses, tangent_product, variable_step
from ._commands import Commands
from ._process_noise import ProcessNoise
from ._uncertain_values import UncertainDirections

# Rates whose difference times a step is smaller have the derivative in place of a quotient.
EQUAL_RATES_TOLERANCE = 1e-4

# The parts on which the modes and the duty after a step depend. They come first in the state.
DRIVEN = ("modes", "duty", "room", "heats", "values")


@final
@dataclass(frozen=True)
class StateLayout:
    """The places of the parts in the vector."""

    modes: int
    duty: int
    heats: int
    common: int
    channels: int
    values: int

    @property
    def size(self) -> int:
        """The length of the vector."""
        return self.of("channels").stop

    @property
    def driven(self) -> int:
        """The length of the driven parts."""
        return self.of("values").stop

    @property
    def dynamic(self) -> int:
        """The length of the parts that the equations of the twin move: the amplitudes and the
        duty."""
        return self.of("duty").stop

    @property
    def fading(self) -> slice:
        """The place of the parts of the common error that begin at a correction of the camera."""
        common = self.of("common")
        return slice(common.start + 1, common.stop)

    def of(self, part: str) -> slice:
        """The place of a part."""
        start = 0
        for name, length in self._lengths():
            if name == part:
                return slice(start, start + length)
            start += length
        raise KeyError(part)

    def _lengths(self) -> list[tuple[str, int]]:
        return [
            ("modes", self.modes),
            ("duty", self.duty),
            ("room", 1),
            ("heats", self.heats),
            ("values", self.values),
            ("common", self.common),
            ("channels", self.channels),
        ]


class Transition(NamedTuple):
    """A step of the state.

    - `mean`: the mean after it.
    - `driven`: the derivatives of the driven parts after it with respect to those before it.
    - `decay`: the factors of the other parts, the errors of the readings.
    - `noise`: the covariance of the noise that it adds.
    """

    mean: Float[Array, " state"]
    driven: Float[Array, "driven driven"]
    decay: Float[Array, " errors"]
    noise: Float[Array, "state state"]

    @property
    def slope(self) -> Float[Array, "state state"]:
        """The derivative with respect to the state before."""
        return jax.scipy.linalg.block_diag(self.driven, jnp.diag(self.decay))


class Evolution(NamedTuple):
    """What a step does whatever the levels of the noise are.

    - `end`: the amplitudes of the modes and the duty after it, which are the first entries.
    - `slope`: their derivatives with respect to the driven parts before it.
    - `late`, `heated`: what a command that is late by 1 s and random heat of 1 W s^0.5 into each
      side of the cells leave in the modes.
    """

    end: Float[Array, " dynamic"]
    slope: Float[Array, "dynamic driven"]
    late: Float[Array, "cells modes"]
    heated: Float[Array, "sides modes"]


class ExpectedReading(NamedTuple):
    """The expected readings, K above the reference, and their derivative with respect to the
    state."""

    mean: Float[Array, " channels"]
    slope: Float[Array, "channels state"]


@final
class AugmentedModel(eqx.Module):
    """The twin with the states of an observer.

    **Arguments:**

    - `twin`: the twin.
    - `directions`: the directions in which its values are uncertain.
    - `noise`: the levels of the noise, as arrays.
    - `columns`: the positions of the read channels among those of the rig.
    - `stepper`: gives the modes of the twin; steps of its size are stable.
    - `room_spread`: the standard deviation of the room about that of the twin, K.
    """

    twin: Twin
    stepper: Stepper
    directions: UncertainDirections | None
    changes: System | None
    """The derivatives of the equations along the directions, the last axis of each leaf."""
    noise: ProcessNoise
    room_spread: Float[Array | np.ndarray, ""]
    """The standard deviation of the room about that of the twin, K."""
    columns: Int[Array | np.ndarray, " channels"]
    relaxation: tuple[float, ...] = eqx.field(static=True)
    """The times within which the error of a correction decays, s."""
    interval: float | None = eqx.field(static=True)
    """The time between two corrections of a camera that corrects itself at equal intervals, s."""
    layout: StateLayout = eqx.field(static=True)

    def __init__(
        self,
        twin: Twin,
        directions: UncertainDirections | None,
        noise: ProcessNoise,
        columns: Sequence[int],
        stepper: Stepper,
        room_spread: float = 2.0,
    ):
        self.room_spread = np.asarray(room_spread, float)
        self.twin = twin
        self.directions = directions
        self.changes = None if directions is None else _changes(twin, directions)
        self.noise = noise
        self.columns = np.asarray(columns)
        self.stepper = stepper
        system = stepper.system
        error = twin.rig.common_error
        self.relaxation = () if error is None else tuple(error.relaxation)
        self.interval = None if error is None else error.interval
        cells = len(system.wiring.cold)
        self.layout = StateLayout(
            modes=stepper.field.modes.rates.size,
            duty=0 if system.lag is None else cells,
            heats=cells,
            common=1 + len(self.relaxation),
            channels=len(self.columns) if len(self.columns) > 1 else 0,
            values=0 if directions is None else directions.count,
        )

    @property
    def shapes(self) -> Float[Array, "nodes modes"]:
        """The temperatures of the nodes for each amplitude."""
        return self.stepper.field.modes.shapes

    def start_spreads(self) -> Float[Array, " state"]:
        """The standard deviations at the start; 0 for modes, duty, room and fading errors."""
        layout, noise = self.layout, self.noise
        spreads = jnp.zeros(layout.size, self.stepper.reference.dtype)
        spreads = spreads.at[layout.of("heats")].set(noise.disturbance)
        spreads = spreads.at[layout.of("common").start].set(noise.common)
        spreads = spreads.at[layout.of("channels")].set(noise.channel)
        if self.directions is not None:
            of_values = self.directions.spreads(noise)
            spreads = spreads.at[layout.of("values")].set(of_values)
        return spreads

    def slope_of_readings(
        self,
        before: Float[Array, " state"],
        after: Float[Array, " state"],
        dt: Float[Array, ""],
        otherwise: Float[Array, " channels"],
    ) -> Float[Array, " channels"]:
        """The rate of the expected readings in a step, K/s, at the twin's own values; `otherwise`
        for a step of length 0."""
        block = self.layout.of("modes")
        matrix, _ = self.stepper.system.output_matrices()
        change = matrix[self.columns] @ (self.shapes @ (after[block] - before[block]))
        return jnp.where(dt > 0, change / jnp.where(dt > 0, dt, 1.0), otherwise)

    def deviation(self, mean: Float[Array, " state"]) -> Float[Array, " nodes"]:
        """The deviations of the nodes from the reference, K."""
        return self.shapes @ mean[self.layout.of("modes")]

    def step(
        self,
        mean: Float[Array, " state"],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> tuple[Transition, Float[Array, " cells"]]:
        """A step of the state, and the duty that reaches the cells at its end.

        **Arguments:**

        - `mean`: the state before.
        - `reached`: the duty that reaches the cells before.
        - `commands`: the commands in the driver's delay.
        - `dt`: the length of the step, s.
        - `levels`: the rig's other inputs during the step (`simulation._input_levels`); None: those
          of the rig file.
        """
        evolution, duty = self.evolution(mean, reached, commands, dt, levels)
        return self.transition(evolution, mean, dt), duty

    def evolution(
        self,
        mean: Float[Array, " state"],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> tuple[Evolution, Float[Array, " cells"]]:
        """What a step of the state does whatever the levels of the noise are, and the duty that
        reaches the cells at its end. The arguments are those of `step`."""
        parts = self._driven(mean)
        end, duty, path = self._evolve(parts, reached, commands, dt, levels)
        slope = self._slopes(parts, reached, commands, dt, levels)
        roots = self._noise_roots(parts[0], reached, path, dt)
        return Evolution(jnp.concatenate([end, duty]), slope, *roots), path[-1]

    def transition(
        self, evolution: Evolution, mean: Float[Array, " state"], dt: Float[Array, ""]
    ) -> Transition:
        """The step with the levels of the noise, from a mean."""
        decay = self.decay(dt)
        driven, first = self.layout.driven, self.layout.of("room").start
        kept = jnp.diag(decay[:driven])[first:]
        after = jnp.concatenate([evolution.end, (mean * decay)[first:]])
        slope = jnp.concatenate([evolution.slope, kept])
        return Transition(after, slope, decay[driven:], self._noise(evolution, dt))

    def exact_step(
        self,
        mean: Float[Array, " state"],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> tuple[Transition, Float[Array, " cells"]]:
        """As `step`, with the exact derivative of `predict_mean` through all stages of the step, so
        that an optimiser converges to the optimum of the step itself."""
        driven = self.layout.driven

        def moved(first: Array) -> tuple[Array, tuple[Array, Array]]:
            before = jnp.concatenate([first, mean[driven:]])
            end, duty, path = self._evolve(self._driven(before), reached, commands, dt, levels)
            after = self._after(before * self.decay(dt), end, duty)
            return after[:driven], (after, path)

        slope, (after, path) = jax.jacfwd(moved, has_aux=True)(mean[:driven])
        roots = self._noise_roots(mean[self.layout.of("modes")], reached, path, dt)
        noise = self._noise(Evolution(after[: self.layout.dynamic], slope, *roots), dt)
        return Transition(after, slope, self.decay(dt)[driven:], noise), path[-1]

    def predict_mean(
        self,
        mean: Float[Array, " state"],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> tuple[Float[Array, " state"], Float[Array, " cells"]]:
        """The same without the derivative and the noise."""
        end, duty, path = self._evolve(self._driven(mean), reached, commands, dt, levels)
        return self._after(mean * self.decay(dt), end, duty), path[-1]

    def _after(
        self,
        decayed: Float[Array, " state"],
        amplitudes: Float[Array, " modes"],
        duty: Float[Array, " duty"],
    ) -> Float[Array, " state"]:
        """The state after a step of which the entries that only decay are known."""
        return jnp.concatenate([amplitudes, duty, decayed[self.layout.of("room").start :]])

    def read(self, mean: Float[Array, " state"]) -> ExpectedReading:
        """The expected readings."""
        layout = self.layout
        z, room, common, own, values = (
            mean[layout.of(part)] for part in ("modes", "room", "common", "channels", "values")
        )
        system = self._system(values)
        matrix, of_room = (table[self.columns] for table in system.output_matrices())
        seen = matrix @ (self.shapes @ z)
        expected = seen + of_room * room + common.sum()
        slope = jnp.zeros((len(self.columns), layout.size), mean.dtype)
        slope = slope.at[:, layout.of("modes")].set(matrix @ self.shapes)
        slope = slope.at[:, layout.of("room")].set(of_room[:, None])
        slope = slope.at[:, layout.of("common")].set(1.0)
        if layout.channels:
            expected = expected + own
            slope = slope.at[:, layout.of("channels")].set(jnp.eye(layout.channels))
        if self.directions is not None:
            of_values = jax.jacfwd(self._seen)(values, z, room)
            slope = slope.at[:, layout.of("values")].set(of_values)
        return ExpectedReading(expected, slope)

    def _seen(
        self, values: Float[Array, " values"], z: Float[Array, " modes"], room: Float[Array, " 1"]
    ) -> Float[Array, " channels"]:
        matrix, of_room = self._system(values).output_matrices()
        return (matrix @ (self.shapes @ z) + of_room * room)[self.columns]

    def _system(self, values: Float[Array, " values"]) -> System:
        """The equations with the changed values."""
        system = self.stepper.system
        if self.directions is None or self.changes is None:
            return system
        amounts = self.directions.limited(values)
        return jax.tree.map(
            lambda leaf, change: leaf if change is None else leaf + change @ amounts,
            system,
            self.changes,
            is_leaf=lambda leaf: leaf is None,
        )

    def _driven(self, mean: Float[Array, " state"]) -> tuple[Array, ...]:
        """The parts on which the amplitudes and the duty after a step depend."""
        return tuple(mean[self.layout.of(part)] for part in DRIVEN)

    def _evolve(
        self,
        parts: tuple[Array, ...],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> tuple[Float[Array, " modes"], Float[Array, " duty"], Float[Array, "stages cells"]]:
        """The amplitudes and the duty after a step, and the duty in it."""
        z, u, room, heats, values = parts
        path = self._path(u, values, reached, commands, dt)
        base, system, conditions = self._systems(values, levels)
        force = self._force(z, path[1], room[0], heats, base, system)
        end = variable_step(self.stepper, z, path, room[0], force, dt, conditions)
        return end, path[-1][: len(u)], path

    def _slopes(
        self,
        parts: tuple[Array, ...],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
        levels: Float[ArrayLike, " inputs"] | None,
    ) -> Float[Array, "modes_and_duty driven"]:
        """The derivatives of the amplitudes and of the duty after a step with respect to the driven
        parts before it.

        They are those of the equations linearised once, at the temperatures of the start and the
        duty of the middle, and not in each stage of the step.
        """
        z, u, room, heats, values = parts

        def path(u: Array, values: Array) -> Array:
            return self._path(u, values, reached, commands, dt)

        at, (of_duty, of_values) = path(u, values), jax.jacfwd(path, (0, 1))(u, values)

        def forces(z: Array, duty: Array, room: Array, heats: Array, values: Array) -> Array:
            base, system, conditions = self._systems(values, levels)
            held = self._force(z, duty, room[0], heats, base, system)
            held = held - tangent_product(self.stepper.field.mass, held)
            lost = losses(self.stepper, z, room[0])
            free = self.stepper.field.force(z, StepInputs(duty, room[0], lost, conditions))
            return jnp.stack([held, free])

        # The numbers of the equations change with the values alone.
        point = z, at[1], room, heats, values
        by_z, by_duty, by_room, by_heats = jax.jacfwd(forces, (0, 1, 2, 3))(*point)
        by_values = jax.jacfwd(forces, 4)(*point)
        # The derivative of the force in each stage, without its dependence on that stage's modes.
        held = [by_z[0], by_duty[0] @ of_duty[1], by_room[0], by_heats[0],
                by_values[0] + by_duty[0] @ of_values[1]]  # fmt: skip
        free = [jnp.zeros((len(at), *by_z[0].shape)), by_duty[1] @ of_duty,
                jnp.broadcast_to(by_room[1], (len(at), *by_room[1].shape)),
                jnp.zeros((len(at), *by_heats[0].shape)), by_duty[1] @ of_values]  # fmt: skip
        stages = jnp.concatenate(held, axis=1) + jnp.concatenate(free, axis=2)
        rates, start = self.stepper.field.modes.rates, jnp.eye(len(z), stages.shape[2])
        rows = [linear_step(by_z[1], rates, start, stages, dt)]
        if len(u):
            none = [jnp.zeros((len(u), count)) for count in (len(z), 1 + len(heats))]
            rows.append(jnp.concatenate([none[0], of_duty[2], none[1], of_values[2]], axis=1))
        return jnp.concatenate(rows)

    def _path(
        self,
        u: Float[Array, " duty"],
        values: Float[Array, " values"],
        reached: Float[Array, " cells"],
        commands: Commands,
        dt: Float[Array, ""],
    ) -> Float[Array, "stages cells"]:
        """The duty at the start, in the middle and at the end of a step."""
        system = self._system(values)
        start = reached if system.lag is None else u
        stages = dt * jnp.array([0.0, 0.5, 1.0], start.dtype)
        return commands.reached(stages, start, system.lag, system.delay)

    def _systems(
        self, values: Float[Array, " values"], levels: Float[ArrayLike, " inputs"] | None
    ) -> tuple[System, System, Conditions | None]:
        """The equations with the original values and with the changed ones, and what the rig's
        other inputs change in the former."""
        base, system = self.stepper.system, self._system(values)
        if levels is None:
            return base, system, None
        stated = jnp.asarray(levels, values.dtype)
        conditions = base.conditions(stated)
        return base.under(conditions), system.under(system.conditions(stated)), conditions

    def _force(
        self,
        z: Float[Array, " modes"],
        duty: Float[Array, " cells"],
        room: Float[Array, ""],
        heats: Float[Array, " heats"],
        base: System,
        system: System,
    ) -> Float[Array, " modes"]:
        """The force of the disturbance heats and of the changed values on the modes."""
        heat = jnp.zeros_like(base.capacitance).at[base.wiring.cold].add(heats)
        if self.directions is not None:
            x, reference = self.shapes @ z, self.stepper.reference
            changed = system.heat_into_nodes(x, duty, reference, room)
            original = base.heat_into_nodes(x, duty, reference, room)
            heat = heat + base.capacitance / system.capacitance * changed - original
        return self.shapes.T @ heat

    def decay(self, dt: Float[Array, ""]) -> Float[Array, " state"]:
        """The factor of each entry that does not depend on others over a step; 0 for the rest."""
        layout, noise = self.layout, self.noise
        decay = jnp.ones(layout.size, dt.dtype)
        decay = decay.at[: layout.of("room").start].set(0.0)
        decay = decay.at[layout.of("heats")].set(jnp.exp(-dt / noise.disturbance_time))
        times = jnp.stack([jnp.asarray(t) for t in (noise.common_time, *self.relaxation)])
        decay = decay.at[layout.of("common")].set(jnp.exp(-dt / times))
        if self.directions is not None:
            of_values = jnp.exp(-dt / self.directions.times(noise))
            decay = decay.at[layout.of("values")].set(of_values)
        return decay.at[layout.of("channels")].set(jnp.exp(-dt / noise.channel_time))

    def _noise_roots(
        self,
        z: Float[Array, " modes"],
        before: Float[Array, " cells"],
        path: Float[Array, "stages cells"],
        dt: Float[Array, ""],
    ) -> tuple[Float[Array, "cells modes"], Float[Array, "sides modes"]]:
        """What a command that is late by 1 s, and random heat of 1 W s^0.5 into each side of the
        cells, leave in the modes at the end of a step."""
        modes, system = self.stepper.field.modes, self.stepper.system
        sides = self._faded_sides(dt)
        temperatures = modes.sides @ z + self.stepper.reference

        def heat(duty: Array) -> Array:
            flows = system.cell_heat(temperatures, duty)
            return jnp.concatenate([-flows.cold, flows.hot])

        _, change = jax.jvp(heat, (path[1],), (path[2] - before,))
        cold, hot = jnp.split(change[:, None] * sides, 2)
        return cold + hot, sides * jnp.sqrt(dt)

    def _noise(self, evolution: Evolution, dt: Float[Array, ""]) -> Float[Array, "state state"]:
        """The covariance of the noise that a step adds."""
        roots = self.noise_roots(evolution)
        block = self.layout.of("modes")
        return jnp.diag(self.walks(dt)).at[block, block].set(roots.T @ roots)

    def noise_roots(self, evolution: Evolution) -> Float[Array, "sources modes"]:
        """What one standard deviation of each source of noise leaves in the modes."""
        late = evolution.late * self.noise.command_time
        return jnp.concatenate([late, evolution.heated * self.noise.heat])

    def _faded_sides(self, dt: Float[Array, ""]) -> Float[Array, "sides modes"]:
        """What heat into each side of the cells, held during a step, leaves in the modes at its
        end, per unit of its integral: fast modes forget most of it.

        The derivative is that of the function of the matrix of the network (Daleckii and Krein, see
        Higham, *Functions of Matrices*, 2008, theorem 3.11), whose change the field has.
        """
        field = self.stepper.field
        rates, heat = field.modes.rates, field.modes.sides.T
        decayed = jnp.where(dt > 0, rates * dt, 1.0)
        fading = -jnp.expm1(-rates * dt) / decayed
        apart = rates[:, None] - rates
        is_near = jnp.abs(apart) * dt < EQUAL_RATES_TOLERANCE
        slope = dt * (jnp.exp(-rates * dt) - fading) / decayed
        secant = (fading[:, None] - fading) / jnp.where(is_near, 1.0, apart)
        by_change = jnp.where(is_near, (slope[:, None] + slope) / 2, secant)
        change = by_change * (field.stiffness - field.mass * rates)

        def faded(heat: Array) -> Array:
            entering = heat - tangent_product(field.mass, heat)
            return fading * entering + tangent_product(change, entering)

        return jax.vmap(faded, in_axes=1)(heat)

    def walks(self, dt: Float[Array, ""]) -> Float[Array, " state"]:
        """The variance that a step adds to each entry beside the modes."""
        layout, noise = self.layout, self.noise
        walks = jnp.zeros(layout.size, dt.dtype)
        walks = walks.at[layout.of("room")].set(jnp.asarray(noise.room) ** 2 * dt)
        if self.directions is not None:
            of_values = self.directions
            regained = _regained(of_values.spreads(noise), of_values.times(noise), dt)
            walks = walks.at[layout.of("values")].set(regained)
        for part, level, time in (
            ("heats", noise.disturbance, noise.disturbance_time),
            ("channels", noise.channel, noise.channel_time),
        ):
            walks = walks.at[layout.of(part)].set(_regained(level, time, dt))
        common = layout.of("common").start
        return walks.at[common].set(_regained(noise.common, noise.common_time, dt))

    def to_degC(self, deviation: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Temperatures in degC for deviations from the reference, K."""
        return deviation + self.stepper.reference - ZERO_CELSIUS

    def from_degC(self, temperature: Float[Array | np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
        """Deviations from the reference, K, for temperatures in degC."""
        return jnp.asarray(temperature) + ZERO_CELSIUS - self.stepper.reference


@persistent_jit_unoptimised
def _changes(twin: Twin, directions: UncertainDirections) -> System:
    """The derivatives of the equations along the directions, at the values of the twin."""

    def changed(amounts: Float[Array, " directions"]) -> System:
        system = twin.with_values(directions.changed(amounts)).system()
        return eqx.filter(system, eqx.is_inexact_array)

    return jax.jacfwd(changed)(jnp.zeros(directions.count))


def _regained(
    level: Float[ArrayLike, "*size"], time: Float[ArrayLike, "*size"], dt: Float[Array, ""]
) -> Float[Array, "*size"]:
    """The variance that an Ornstein-Uhlenbeck process regains within a step."""
    return jnp.asarray(level) ** 2 * -jnp.expm1(-2 * dt / jnp.asarray(time))
