"""Work on one chunk of draws, compiled once for its size: linear algebra, steps, reductions.

Each part is a compiled function of its own. XLA would compute what one part makes once for every
use in the next, and copy the modes into another order at every step.
"""

from collections.abc import Callable, Mapping
from typing import Literal, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..physics import System, Twin
from ._ambient import ambient_of_samples, reference_temperature
from ._compressed import CompressedRecording
from ._initial import initial_temperatures, keeps_symmetry
from ._modes import Modes
from ._schedule import Schedule
from ._solve import (
    StepReadings,
    arriving,
    coupling_left,
    schedule_modes,
    solve_steps,
)

Reduction = Literal["cost", "final", "minimum", "maximum", "spread", "deviation"]


@final
class Prepared(eqx.Module):
    """Draws ready to be stepped: equations, modes, initial temperatures (K), `left_coupling`."""

    systems: System
    modes: Modes
    starts: Float[Array, "*chunk nodes"]
    coupling: Float[Array, "*chunk"]


@final
class Stepped(eqx.Module):
    """What was read from the channels' places and from the plate's elements at all steps."""

    channels: StepReadings
    elements: StepReadings | None
    failed: Bool[Array, "*chunk"]


@eqx.filter_jit
def prepare_chunk(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    schedule: Schedule,
    initial: str | Float[Array | np.ndarray, " starts"] | None,
) -> Prepared:
    """All linear algebra of a chunk."""

    def one(values: Mapping[str, Float[Array | np.ndarray, ""]]) -> Prepared:
        system = twin.with_parameters(values).system(lumped=keeps_symmetry(initial))
        modes = schedule_modes(system, schedule)
        coupling = coupling_left(system, modes, schedule)
        reference = reference_temperature(system, schedule)
        start = initial_temperatures(system, initial, schedule.duty[0], reference)
        return Prepared(system, modes, start, coupling)

    return jax.vmap(one)(draws)


@eqx.filter_jit
def step_chunk(
    prepared: Prepared,
    *,
    schedule: Schedule,
    columns: Int[Array | np.ndarray, " channels"],
    with_plate: bool,
    at_rest: bool,
) -> Stepped:
    """Solves all steps."""
    wiring = prepared.systems.wiring
    readout = jnp.asarray(wiring.channel_weights)[columns]
    if with_plate:
        # Every element of the rig's plate counts, also where one node stands for two.
        plate = np.eye(len(wiring.netlist.nodes))[wiring.rig_elements]
        readout = jnp.concatenate([readout, plate])

    def one(draw: Prepared) -> Stepped:
        system = draw.systems
        seen = arriving(schedule, system, at_rest)
        read = solve_steps(system, seen, draw.modes, draw.starts, readout, at_rest)
        channels, elements = (
            StepReadings(read.values[:, part], read.slopes[:, part], read.doubt)
            for part in (slice(len(columns)), slice(len(columns), None))
        )
        failed = ~(system.physical & jnp.all(jnp.isfinite(read.values)))
        return Stepped(channels, elements if with_plate else None, failed)

    return jax.vmap(one)(prepared)


@eqx.filter_jit
def sample_chunk(
    prepared: Prepared,
    stepped: Stepped,
    *,
    schedule: Schedule,
    columns: Int[Array | np.ndarray, " channels"],
    at_rest: bool,
    last: bool = False,
) -> Float[Array, "chunk times channels"]:
    """Temperatures of the channels at the samples, or at the last alone, degC; NaN where failed."""
    which = slice(-1, None) if last else slice(None)

    def one(system: System, stepped: Stepped) -> Array:
        seen = arriving(schedule, system, at_rest)
        deviation = stepped.channels.at_samples(seen, which)
        reference = reference_temperature(system, schedule)
        ambient = ambient_of_samples(system, schedule, which)
        gain = system.gain[columns]
        reading = ambient + gain * (deviation - ambient) + (reference - 273.15)
        return jnp.where(stepped.failed, jnp.nan, reading)

    return jax.vmap(one)(prepared.systems, stepped)


@eqx.filter_jit
def plate_chunk(
    prepared: Prepared, stepped: Stepped, *, schedule: Schedule, at_rest: bool
) -> Float[Array, "chunk elements"]:
    """Deviations of the plate's elements at the last sample, K; NaN where it failed."""

    def one(system: System, stepped: Stepped) -> Array:
        assert stepped.elements is not None
        seen = arriving(schedule, system, at_rest)
        elements = stepped.elements.at_samples(seen, slice(-1, None))[0]
        return jnp.where(stepped.failed, jnp.nan, elements)

    return jax.vmap(one)(prepared.systems, stepped)


@eqx.filter_jit
def compressed_errors(
    prepared: Prepared,
    stepped: Stepped,
    recorded: CompressedRecording,
    columns: Int[Array | np.ndarray, " channels"],
) -> Float[Array, "chunk rows channels"]:
    """Simulated less recorded in the recording's combinations, K; NaN where it failed."""

    def one(system: System, stepped: Stepped) -> Array:
        seen = system.gain[columns] * stepped.channels.at_samples(recorded.schedule)
        offset = system.ambient_temperature - 273.15
        target = jnp.asarray(recorded.target, seen.dtype)
        error = seen + offset * jnp.asarray(recorded.ones, seen.dtype)[:, None] - target
        return jnp.where(stepped.failed, jnp.nan, error)

    return jax.vmap(one)(prepared.systems, stepped)


@eqx.filter_jit
def compressed_cost(
    errors: Float[Array, "chunk rows channels"], recorded: CompressedRecording
) -> Float[Array, "chunk channels"]:
    """Mean squared error of each channel, K^2."""
    samples, beyond = (
        jnp.asarray(part, errors.dtype) for part in (recorded.samples, recorded.beyond)
    )
    return jnp.sum(errors**2, axis=1) / samples + beyond


@eqx.filter_jit
def sample_cost(
    temperatures: Float[Array, "chunk times channels"],
    recorded: Float[Array | np.ndarray, "times channels"],
    counted: Float[Array | np.ndarray, " times"],
) -> Float[Array, "chunk channels"]:
    """Mean squared error of each channel over the samples that are `counted` (1, the others 0),
    K^2."""
    squares = (temperatures - jnp.asarray(recorded, temperatures.dtype)) ** 2
    counts = jnp.asarray(counted, temperatures.dtype)
    return jnp.einsum("t,dtc->dc", counts, squares) / counts.sum()


EXTREMES: dict[str, Callable[[Array], Array]] = {
    "minimum": eqx.filter_jit(lambda temperatures: temperatures.min(axis=1)),
    "maximum": eqx.filter_jit(lambda temperatures: temperatures.max(axis=1)),
}
"""Over time, of `(chunk, times, channels)`."""

UNIFORMITY: dict[str, Callable[[Array], Array]] = {
    "spread": eqx.filter_jit(lambda elements: elements.max(axis=1) - elements.min(axis=1)),
    "deviation": eqx.filter_jit(lambda elements: elements.std(axis=1)),
}
"""Over the plate, of `(chunk, elements)`."""
