"""A network through a whole schedule: the loop over exponential steps and what is read from it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics import System
from ._actuator import lagged_duty
from ._delay import delayed_schedule
from ._exponential import Inputs, ModalField, exponential_step, step_factors
from ._modes import Modes, network_modes
from ._schedule import Schedule


def solve_schedule(
    system: System,
    schedule: Schedule,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    modes: Modes | None = None,
    at_rest: bool = False,
) -> Float[Array, "times outputs"]:
    """Runs a network through a schedule.

    **Arguments:**

    - `system`: the equations.
    - `schedule`: steps, inputs and samples.
    - `initial`: absolute node temperatures at the start, K.
    - `readout`: which weighted sums of node temperatures to return.
    - `modes`: of the system on this schedule, where they are known already.
    - `at_rest`: whether the first duty cycle has been held for ever, which a driver that lags
      behind its command remembers.

    **Returns:** the sums of the nodes' deviations from the reference at each sample, K.
    The reference is `reference_temperature(system, schedule)`.
    """
    dtype = system.capacitance.dtype
    reference = reference_temperature(system, schedule)
    modes = schedule_modes(system, schedule) if modes is None else modes
    field = ModalField.of(system, modes, reference)
    if system.delay is not None:
        schedule = delayed_schedule(schedule, system.delay, at_rest)
    factors = step_factors(modes.rates, jnp.asarray(schedule.sizes, dtype))
    duty = jnp.asarray(schedule.duty, dtype)
    if system.lag is not None:
        steps = jnp.asarray(schedule.sizes, dtype)[schedule.size]
        starts = jnp.cumsum(steps) - steps
        stages = starts[:, None] + steps[:, None] * jnp.array([0.0, 0.5, 1.0], dtype)
        duty = lagged_duty(system.lag, None, starts, duty, stages, at_rest)
    if schedule.ambient is None:
        ambient = jnp.zeros(duty.shape[0], dtype)
    else:
        ambient = jnp.asarray(schedule.ambient, dtype) - reference

    def advance(state: tuple[Array, Array], step: Any) -> tuple[tuple[Array, Array], Any]:
        size, inputs, following = step
        of_size = jax.tree.map(lambda table: table[size], factors)
        amplitudes = exponential_step(*state, of_size, field, inputs)
        # The force that starts the next step, under its inputs.
        after = amplitudes, field.force(amplitudes, following)
        return after, after

    inputs = Inputs(duty, ambient)
    at_starts = inputs if duty.ndim == 2 else Inputs(duty[:, 0], ambient)
    at_ends = inputs if duty.ndim == 2 else Inputs(duty[:, 2], ambient)
    following = jax.tree.map(lambda a, b: jnp.append(a[1:], b[-1:], axis=0), at_starts, at_ends)
    start = modes.amplitudes(initial - reference)
    state = start, field.force(start, jax.tree.map(lambda rows: rows[0], at_starts))
    _, after = jax.lax.scan(advance, state, (jnp.asarray(schedule.size), inputs, following))
    amplitudes, forces = jax.tree.map(lambda a, b: jnp.append(a[None], b, axis=0), state, after)
    read = (jnp.asarray(readout, dtype) @ modes.shapes).T
    values, slopes = amplitudes @ read, (forces - modes.rates * amplitudes) @ read
    # Without the barrier XLA computes these products once for every sample.
    values, slopes = jax.lax.optimization_barrier((values, slopes))
    w = jnp.asarray(schedule.weights, dtype)[..., None]
    at = jnp.asarray(schedule.step_of)
    before = jnp.maximum(at - 1, 0)
    return (
        w[:, 0] * values[at]
        + w[:, 1] * slopes[at]
        + w[:, 2] * values[at + 1]
        + w[:, 3] * slopes[at + 1]
        + w[:, 4] * values[before]
        + w[:, 5] * slopes[before]
    )


def schedule_modes(system: System, schedule: Schedule) -> Modes:
    """The modes with the cells at rest under the schedule's mean duty cycle."""
    dtype = system.capacitance.dtype
    lengths = jnp.asarray(schedule.sizes, dtype)[schedule.size]
    duty = lengths @ jnp.asarray(schedule.duty, dtype) / lengths.sum()
    return network_modes(system, duty, reference_temperature(system, schedule))


def reference_temperature(system: System, schedule: Schedule) -> Float[Array, ""]:
    """What deviations are counted from: the ambient at the start, recorded or the rig's, K."""
    if schedule.ambient is None:
        return system.ambient_temperature
    return jnp.asarray(schedule.ambient[0], system.capacitance.dtype)
