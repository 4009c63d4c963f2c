"""The compiled programs for a chunk of draws on an accelerator: those that need no modes.

Eigenproblems take a third of the time of a run by modes on an accelerator. Rodas5P needs none, and
takes fewer steps, each of some thousand operations that act on all draws at once.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit
from .._jax_settings import in_precision
from .._padded_rows import padded_count
from .._sparse import SparseLU
from ..io import Experiment
from ..physics import Twin
from ._chunk_programs import Precision, Prepared, Stepped
from ._initial import CheckedInitial, initial_temperatures, keeps_symmetry
from ._integrate import StepReadings, largest
from ._modes import MAX_SPAN, network_span
from ._rosenbrock_step import NODES, added, rosenbrock_step, step_matrix
from ._scalar_network import ScalarNetwork, Scalars
from ._time_grid import (
    SIZES,
    InputSummary,
    StepRule,
    TimeGrid,
    build_time_grid,
    reference_temperature,
    settling_after_reversals,
    with_padding,
)

# Integrates many draws of a network by Rodas5P, every number of a draw an array over the draws.
#
# A step is some thousand multiplications and additions of such arrays. XLA fuses them to about
# a hundred kernels of an accelerator (jax 0.11.2; `benchmarks/results/gpu.md`), none of which
# calls a library or waits for the host.


class HeldStep(NamedTuple):
    """What is held during a step: numbers that all draws share.

    - `size`: its length, s; 0 for a step that fills a grid up.
    - `begin`: the time at its start, s.
    - `ambient`: the recorded ambient's deviation from the reference at the start, in the middle and
      at the end, K.
    - `command`: of each cell, -1 to 1.
    """

    size: Float[Array, "*steps"]
    begin: Float[Array, "*steps"]
    ambient: Float[Array, "*steps 3"]
    command: Float[Array, "*steps cells"]


class ScalarState(NamedTuple):
    """Where a run is.

    - `rises`: the deviations from the reference, K.
    - `duty`: what reaches each cell, -1 to 1.
    - `errors`: the sums of the absolute error estimates of the steps so far, K.
    """

    rises: Scalars
    duty: Scalars
    errors: Scalars


class ScalarRun(NamedTuple):
    """The nodes during a run, with an axis for the draws behind the others.

    - `rises`, `slopes`: the deviations from the reference, K, and their slopes, K/s. Row k belongs
      to the start of step k, the last row to the end. A slope is that under the inputs that follow.
    - `errors`: the sums of the absolute error estimates of all steps, K.
    """

    rises: Float[Array, "ends nodes draws"]
    slopes: Float[Array, "ends nodes draws"]
    errors: Float[Array, "nodes draws"]


def integrate_scalars(network: ScalarNetwork, start: Scalars, grid: TimeGrid) -> ScalarRun:
    """Integrates over the steps of a grid.

    **Arguments:**

    - `network`: the network of many draws.
    - `start`: the deviations of the nodes from the reference at the start, K.
    - `grid`: the steps, which the draws share, with the inputs that are held during each.
    """
    dtype, shape = network.reference.dtype, network.reference.shape
    lu, rest = SparseLU(network.pattern), jnp.zeros(shape, dtype)
    steps = held_steps(grid, dtype)
    command = steps.command[0] if grid.steady_start else jnp.zeros_like(steps.command[0])
    duty = [jnp.broadcast_to(of_cell, shape) for of_cell in command]

    def step(state: ScalarState, held: HeldStep) -> tuple[ScalarState, tuple[Scalars, Scalars]]:
        after, slopes = advance(network, lu, state, held)
        return after, (state.rises, slopes)

    state = ScalarState(start, duty, [rest] * len(start))
    end, (rises, slopes) = jax.lax.scan(step, state, steps)
    last = jax.tree.map(lambda rows: rows[-1], steps)
    at_end = last._replace(begin=last.begin + last.size)
    last_slopes = network.slope(
        end.rises, duty_at(network, at_end, end.duty, rest), ambient_at(network, at_end, rest)
    )
    return ScalarRun(
        rises=jnp.concatenate([jnp.stack(rises, axis=1), jnp.stack(end.rises)[None]]),
        slopes=jnp.concatenate([jnp.stack(slopes, axis=1), jnp.stack(last_slopes)[None]]),
        errors=jnp.stack(end.errors),
    )


def held_steps(grid: TimeGrid, dtype: DTypeLike) -> HeldStep:
    """The steps of a grid, each field with a leading axis for the steps."""
    sizes = jnp.asarray(grid.sizes)[grid.size]
    ambient = jnp.zeros((len(sizes), 3))
    if grid.ambient is not None and grid.ambient_at is not None:
        ambient = jnp.asarray(grid.ambient) - grid.ambient_at[0]
    steps = HeldStep(sizes, jnp.cumsum(sizes) - sizes, ambient, jnp.asarray(grid.duty))
    return jax.tree.map(lambda rows: rows.astype(dtype), steps)


def advance(
    network: ScalarNetwork, lu: SparseLU, state: ScalarState, step: HeldStep
) -> tuple[ScalarState, Scalars]:
    """Takes a step.

    **Returns:** the state at its end, and the slopes at its start under its inputs, K/s.
    """
    moves = step.size > 0
    size = jnp.where(moves, step.size, 1.0)
    elapsed = {part: jnp.broadcast_to(part * size, network.reference.shape) for part in set(NODES)}
    duty = {part: duty_at(network, step, state.duty, time) for part, time in elapsed.items()}
    ambient = {part: ambient_at(network, step, time) for part, time in elapsed.items()}
    first = network.slope(state.rises, duty[0.0], ambient[0.0])
    jacobian = network.jacobian(state.rises, duty[0.0], ambient[0.0])
    factors = lu.factorise(step_matrix(jacobian, size))
    result = rosenbrock_step(
        state.rises,
        size,
        lambda stage, rises: network.slope(list(rises), duty[NODES[stage]], ambient[NODES[stage]]),
        _time_slope(network, state, step, duty[0.0], ambient[0.0]),
        lambda right: lu.solve(factors, right),
        first,
    )
    after = ScalarState(
        [jnp.where(moves, end, x) for end, x in zip(result.end, state.rises, strict=True)],
        [jnp.where(moves, end, u) for end, u in zip(duty[1.0], state.duty, strict=True)],
        added(state.errors, [jnp.where(moves, jnp.abs(e), 0.0) for e in result.error]),
    )
    return after, first


def duty_at(
    network: ScalarNetwork, step: HeldStep, before: Scalars, elapsed: Float[Array, " draws"]
) -> Scalars:
    """The duty that reaches each cell some time after the start of a step, at which it was
    `before`: the command, or what lags behind it."""
    if network.lag is None:
        return [jnp.broadcast_to(command, elapsed.shape) for command in step.command]
    left = jnp.exp(-elapsed / network.lag)
    return [
        command + (duty - command) * left
        for command, duty in zip(step.command, before, strict=True)
    ]


def ambient_at(
    network: ScalarNetwork, step: HeldStep, elapsed: Float[Array, " draws"]
) -> Float[Array, " draws"]:
    """The ambient's deviation from the reference some time after the start of a step, K."""
    start, middle, end = step.ambient
    part = elapsed / jnp.where(step.size > 0, step.size, 1.0)
    held = start + part * (4 * middle - 3 * start - end + part * 2 * (start + end - 2 * middle))
    return held if network.drift is None else held + network.drift * (step.begin + elapsed)


def _time_slope(
    network: ScalarNetwork,
    state: ScalarState,
    step: HeldStep,
    duty: Scalars,
    ambient: Float[Array, " draws"],
) -> Scalars | None:
    """The change of the slopes with the inputs at the start of a step, K/s^2; None where these are
    held."""
    if network.lag is None and network.drift is None:
        return None
    rest = jnp.zeros_like(network.reference)
    turning = [rest] * len(duty)
    if network.lag is not None:
        turning = [(c - u) / network.lag for c, u in zip(step.command, duty, strict=True)]
    drift = rest if network.drift is None else network.drift
    return network.time_slope(state.rises, duty, ambient, turning, drift)


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


def scalar_grid(
    twin: Twin, experiment: Experiment, draws: int, *, steady_start: bool
) -> TimeGrid | None:
    """The padded steps of Rodas5P for `count` draws; None where the modes of the default solver are
    as good."""
    wiring = twin.wiring
    if wiring.inputs or len(wiring.netlist.nodes) > MAX_NODES or draws < MIN_DRAWS:
        return None
    grid = _padded_grid(experiment, wiring.lag is not None)
    if len(grid.size) > MAX_STEPS:
        return None
    return replace(grid, steady_start=True) if steady_start else grid


def scalar_chunk_size() -> int:
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
def prepare_scalar_chunk(
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
def step_scalar_chunk(
    prepared: Prepared,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " channels"],
    with_plate: bool,
    with_sides: bool,
) -> Stepped:
    """Computes all steps of a chunk.

    **Arguments:** those of `step_chunk`; the grid is that of `scalar_grid`, delayed where the
    driver has a delay.
    """
    wiring = prepared.system.wiring

    def of_draw(draw: Prepared) -> tuple[ScalarNetwork, list[Array]]:
        drive = draw.drive(grid)
        network = ScalarNetwork.of(draw.system, drive.reference, drive.ambient_drift)
        rises = draw.start - drive.reference
        return network, [rises[node] for node in range(rises.size)]

    network, start = jax.vmap(of_draw)(prepared)
    run = integrate_scalars(network, start, grid)
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
