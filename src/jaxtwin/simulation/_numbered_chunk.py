"""The compiled programs for a chunk of draws on an accelerator: those that need no modes.

Eigenproblems take a third of the time of a run by modes on an accelerator. Rodas5P needs none, and
takes fewer steps, each of some thousand operations that act on all draws at once.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit
from .._jax_settings import in_precision
from ..io import Experiment
from ..physics import Twin
from ._chunk_programs import Precision, Prepared, Stepped
from ._initial import CheckedInitial, initial_temperatures, keeps_symmetry
from ._integrate_numbers import integrate_numbers
from ._numbered_network import NumberedNetwork
from ._padding import SIZES, padded_count, with_padding
from ._resolution import MAX_SPAN, network_span
from ._step_readings import StepReadings, largest
from ._time_grid import (
    InputSummary,
    StepRule,
    TimeGrid,
    build_time_grid,
    reference_temperature,
    settling_after_reversals,
)

# The first step after an input change, s; the ratio of a step to the time since that change; the
# longest step, s. The samples inside a step are less accurate than its end: with these numbers the
# errors around the bundled rigs are at most half a millikelvin at samples and some 1e-5 K at the
# end.
FIRST_STEP, GROWTH, LARGEST_STEP = 0.125, 0.22, 256.0

# With more steps, such as those of a drive that changes at every sample, the modes pay for
# themselves.
MAX_STEPS = 200

# The largest network. The compilation of a step takes half a minute for 30 nodes.
MAX_NODES = 40

# The number of draws from which on a compilation of up to half a minute more is worth its time.
MIN_DRAWS = 1_000_000

# The number of draws in a chunk unless trajectories are kept, on a device with less and with more
# memory than `MUCH_MEMORY`. For 30 nodes in float64 two chunks take 19 and 27 GiB, and the larger
# ones are computed nearly twice as fast.
SMALL_CHUNK, LARGE_CHUNK = 32_768, 65_536

# Bytes of a device that JAX may use.
MUCH_MEMORY = 2**35


def numbered_grid(
    twin: Twin, experiment: Experiment, draws: int, *, steady_start: bool
) -> TimeGrid | None:
    """The padded steps of Rodas5P for so many draws; None where the modes of the default solver are
    as good."""
    wiring = twin.wiring
    if wiring.inputs or len(wiring.netlist.nodes) > MAX_NODES or draws < MIN_DRAWS:
        return None
    grid = _padded_grid(experiment, wiring.lag is not None)
    if len(grid.size) > MAX_STEPS:
        return None
    return replace(grid, steady_start=True) if steady_start else grid


def numbered_chunk_size() -> int:
    """The number of draws in a chunk unless trajectories are kept."""
    memory = jax.devices()[0].memory_stats() or {}
    return LARGE_CHUNK if memory.get("bytes_limit", 0) >= MUCH_MEMORY else SMALL_CHUNK


@lru_cache(maxsize=16)
def _padded_grid(experiment: Experiment, lags: bool) -> TimeGrid:
    settling = settling_after_reversals(experiment, lags)
    rule = StepRule((), GROWTH, LARGEST_STEP, FIRST_STEP, doubles=False, settling=settling)
    grid = build_time_grid(experiment, rule)
    count = padded_count(len(grid.sizes) + 1, SIZES)
    sizes = np.append(grid.sizes, np.zeros(count - len(grid.sizes)))
    return with_padding(replace(grid, sizes=sizes), 0)


@persistent_jit
def prepare_numbered(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    inputs: InputSummary,
    initial: CheckedInitial,
    precision: Precision = "float64",
) -> Prepared:
    """Computes the systems and the initial temperatures of a chunk, in float64, without modes.

    **Arguments:** those of `prepare_chunk`.
    """

    def prepare_draw(values: Mapping[str, Float[Array | np.ndarray, ""]]) -> Prepared:
        system = twin.with_values(values).system(lumped=keeps_symmetry(initial))
        reference = reference_temperature(system, inputs)
        start = initial_temperatures(system, initial, inputs.first, reference)
        # Without modes the slowest rate is unknown. A span that is too large for the longest time
        # constant there may be is left to the default solver, which knows it.
        rest = jnp.zeros_like(reference)
        span = network_span(system, rest, jnp.asarray(inputs.duration, reference.dtype))
        number = jnp.where(span <= MAX_SPAN, 0.0, jnp.inf)
        return Prepared(system, None, start, number, None)

    prepared = jax.vmap(prepare_draw)(draws)
    return prepared if precision == "float64" else in_precision(prepared, precision)


@persistent_jit
def step_numbered(
    prepared: Prepared,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " channels"],
    with_plate: bool,
    with_sides: bool,
) -> Stepped:
    """Computes all steps of a chunk.

    **Arguments:** those of `step_chunk`; the grid is that of `numbered_grid`, delayed where the
    driver has a delay.
    """
    wiring = prepared.system.wiring

    def of_draw(draw: Prepared) -> tuple[NumberedNetwork, list[Array]]:
        drive = draw.drive(grid)
        network = NumberedNetwork.of(draw.system, drive.reference, drive.ambient_drift)
        rises = draw.start - drive.reference
        return network, [rises[node] for node in range(rises.size)]

    network, start = jax.vmap(of_draw)(prepared)
    run = integrate_numbers(network, start, grid)
    rises, slopes = (jnp.transpose(table, (2, 0, 1)) for table in (run.rises, run.slopes))

    def read(draw: Prepared, rises: Array, slopes: Array, errors: Array) -> Stepped:
        weights = jnp.asarray(draw.system.channel_weights, rises.dtype)
        chosen = weights[columns]
        estimate = largest(jnp.abs(weights) @ errors)
        sides = np.concatenate([wiring.cold, wiring.hot])

        def nodes(which: np.ndarray) -> StepReadings:
            return StepReadings(rises[:, which], slopes[:, which], estimate)

        return Stepped(
            channels=StepReadings(rises @ chosen.T, slopes @ chosen.T, estimate),
            elements=nodes(np.asarray(wiring.rig_elements)) if with_plate else None,
            sides=nodes(sides) if with_sides else None,
            failed=~(draw.system.is_valid & jnp.all(jnp.isfinite(rises))),
        )

    return jax.vmap(read)(prepared, rises, slopes, run.errors.T)
