"""Simulates many closed loops, in chunks of draws, of which only measures are kept."""

from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compilation import persistent_jit, persistent_jit_unoptimised
from ..._jax_settings import in_precision, own_settings
from ...physics import Fault, System, Twin
from ...simulation import (
    Precision,
    Reductions,
    Stepper,
    assembled,
    check_draw,
    check_values,
    is_multiple,
    valid_draws,
    work_in_chunks,
)
from ..controllers._controller import AbstractController, with_values
from ._closed_loop import run_loop
from ._loop_signals import ClosedLoop
from ._measures import Measure, units_of
from ._scenario import Scenario

# The number of loops that a core computes at a time. With 64, a step of a loop costs twice as much;
# with 512, no less.
MAX_CHUNK = 256

# The memory for the loops that a core computes at a time, before their measures are computed.
CHUNK_BYTES = 2**28


def twin_at_medians(twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]]) -> Twin:
    """Returns the twin with the medians of the drawn parameters over all valid draws, for checks
    before the simulation.

    **Raises:** `ParameterError` if no draw is valid, or without draws if the twin is not.
    """
    if not draws:
        check_values(twin)
        return twin
    is_valid = valid_draws(twin, draws)
    if not is_valid.any():
        check_draw(twin, draws, 0)
    return twin.with_values({name: float(np.median(v[is_valid])) for name, v in draws.items()})


def longest_delay(twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]]) -> float:
    """Returns the longest delay of the driver in all draws, s."""
    own, delay = assembled(twin).delay, twin.wiring.delay
    if own is None or delay is None:
        return 0.0
    if delay.names.isdisjoint(draws):
        return float(own)
    return float(_longest(twin, {name: np.asarray(v, float) for name, v in draws.items()}))


@persistent_jit_unoptimised
def _longest(
    twin: Twin, draws: Mapping[str, Float[Array | np.ndarray, " draws"]]
) -> Float[Array, ""]:
    def delay(values: Mapping[str, Array]) -> Array:
        result = twin.with_values(values).system().delay
        return jnp.zeros(()) if result is None else result

    return jnp.max(jax.vmap(delay)({name: jnp.asarray(v) for name, v in draws.items()}))


def simulate_many_loops(
    twin: Twin,
    controller: AbstractController,
    scenario: Scenario,
    *,
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    controller_draws: Mapping[str, Float[np.ndarray, "draws ..."]],
    count: int,
    measures: Mapping[str, Measure],
    precision: Precision,
    workers: int | None,
    fault: Fault | None = None,
) -> Reductions:
    """Simulates `count` loops, with a draw of the plant, of the controller or of both in each.

    The arguments have been checked by `simulate_closed_loops`; `scenario` allows for the longest
    delay of all draws. A fault changes the equations of each draw, from the start.
    """
    dtype = jnp.float32 if precision == "float32" else jnp.float64
    whole = is_whole_delay(twin, draws, scenario.step)
    if not draws:
        # Loops that share a plant also get a copy each: products with a matrix for each draw take
        # three quarters of the time of products with a single matrix.
        name, value = next(iter(twin.values.items()))
        draws = {name: np.full(count, float(value))}
    rows = {f"plant {name}": np.asarray(values) for name, values in draws.items()}
    rows |= {f"controller {name}": values for name, values in controller_draws.items()}
    sizes = scenario.step, scenario.longest_delay

    def work(chunk: Mapping[str, np.ndarray]) -> Mapping[str, Array]:
        with own_settings():
            plant, loops = (
                {
                    name.removeprefix(kind): values
                    for name, values in chunk.items()
                    if name.startswith(kind)
                }
                for kind in ("plant ", "controller ")
            )
            if fault is None:
                steppers = steppers_of(twin, plant, *sizes, whole)
            else:
                # A fault is a closure, whose program could not be kept; as it is, all faults share
                # the programs before and after it.
                faulty = jax.vmap(fault)(_systems_of(twin, plant))
                steppers = _steppers_of_systems(faulty, *sizes, whole)
            steppers, fixed, varied = in_precision((steppers, scenario, loops), dtype)
            chosen = in_precision(controller, dtype)
            kept = tuple(measures.items())
            return _measured(steppers, chosen, varied, fixed, kept)

    loop_bytes = (
        jnp.dtype(dtype).itemsize * scenario.ambient.size * numbers_per_step(twin, scenario)
    )
    chunk_size = min(max(CHUNK_BYTES // loop_bytes, 1), MAX_CHUNK)
    if controller.needs_one_thread:
        workers = 1
    results = work_in_chunks(rows, work, chunk_size=chunk_size, workers=workers)
    # Energy and peak power are measures of the loop here, computed at every step of the plant.
    custom = {name: results[name] for name in measures}
    failed = results["failed"] | (scenario.switched_off is not None)
    return Reductions(twin.channels, failed, custom=custom, custom_units=units_of(measures))


def numbers_per_step(twin: Twin, scenario: Scenario) -> int:
    """Returns the number of values of a `ClosedLoop` at each step of the plant."""
    outputs, cells = len(scenario.output_weights), len(twin.netlist.cells)
    return 2 + len(twin.netlist.nodes) + len(twin.channels) + 3 * outputs + 2 * cells


def is_whole_delay(twin: Twin, drawn: Iterable[str], step: float) -> bool:
    """Whether the driver's delay is the same whole number of plant steps in all draws."""
    delay = twin.wiring.delay
    return delay is None or (
        delay.names.isdisjoint(drawn) and is_multiple(assembled(twin).delay, step)
    )


@persistent_jit_unoptimised
def steppers_of(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    step: float,
    longest_delay: float,
    is_whole_delay: bool,
) -> Stepper:
    """Makes a stepper for each draw; its numbers are NaN for invalid draws."""

    def stepper_of(values: Mapping[str, Array]) -> Stepper:
        return _stepper_of(twin.with_values(values), step, longest_delay, is_whole_delay)

    return jax.vmap(stepper_of)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit_unoptimised
def _systems_of(twin: Twin, draws: Mapping[str, Float[Array | np.ndarray, " chunk"]]) -> System:
    """Makes the equations of each draw."""

    def system_of(values: Mapping[str, Array]) -> System:
        return twin.with_values(values).system()

    return jax.vmap(system_of)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit_unoptimised
def _steppers_of_systems(
    systems: System, step: float, longest_delay: float, is_whole_delay: bool
) -> Stepper:
    """Makes a stepper for each of several equations."""

    def stepper_of(system: System) -> Stepper:
        return _stepper_of(system, step, longest_delay, is_whole_delay)

    return jax.vmap(stepper_of)(systems)


def _stepper_of(
    twin: Twin | System, step: float, longest_delay: float, is_whole_delay: bool
) -> Stepper:
    """Makes a stepper, whose numbers are NaN if no rig can have the values."""
    stepper = Stepper(twin, step, longest_delay=longest_delay, is_whole_delay=is_whole_delay)
    valid = stepper.system.is_valid

    def marked(leaf: Array) -> Array:
        is_real = jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.where(valid, leaf, jnp.nan) if is_real else leaf

    return jax.tree.map(marked, stepper)


@persistent_jit
def _measured(
    steppers: Stepper,
    controller: AbstractController,
    varied: Mapping[str, Float[Array | np.ndarray, "chunk ..."]],
    scenario: Scenario,
    measures: tuple[tuple[str, Measure], ...],
) -> dict[str, Array]:
    """Computes the measures of a chunk of loops, each with its stepper."""

    def of_draw(stepper: Stepper, values: Mapping[str, Array | np.ndarray]) -> dict[str, Array]:
        changed = with_values(controller, values)
        loop: ClosedLoop = run_loop(stepper, changed, scenario, single_precision_losses=True)
        result = {name: jnp.asarray(function(loop)) for name, function in measures}
        is_finite = loop.stays_finite
        result = {
            name: (
                jnp.where(is_finite, value, jnp.nan)
                if jnp.issubdtype(value.dtype, jnp.floating)
                else value
            )
            for name, value in result.items()
        }
        return {**result, "failed": ~is_finite}

    return jax.vmap(of_draw)(steppers, dict(varied))
