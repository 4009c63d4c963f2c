"""The compiled programs for a chunk of draws: linear algebra, steps, readings.

Each part is compiled separately. In a single program, XLA would compute the results of one part
again for every use in the next, and transpose the modes at every step.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Literal, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import in_precision
from ..physics import System, Twin
from ._compressed import CompressedRecording
from ._drive import Drive, delayed_time_grid
from ._initial import CheckedInitial, initial_temperatures, keeps_symmetry
from ._integrate import StepReadings, integrate
from ._modes import Modes, run_modes
from ._power import SupplyPower, supply_power
from ._refinement import stability_number
from ._time_grid import InputSummary, TimeGrid, reference_temperature

Precision: TypeAlias = Literal["float64", "float32"]
"""The precision in which the temperatures of a batch are computed."""


@final
class Prepared(eqx.Module):
    """A chunk of draws, or a single draw, before its first step.

    - `system`, `modes`: the equations. The steps of `_scalar_chunk` need no modes: None.
    - `start`: the absolute initial temperatures, K.
    - `stability_number`: see the function `stability_number`.
    - `grid`: the time grid with the draw's own delay; None if all draws share the grid.
    """

    system: System
    modes: Modes | None
    start: Float[Array, "*chunk nodes"]
    stability_number: Float[Array, "*chunk"]
    grid: TimeGrid | None

    def drive(self, shared: TimeGrid) -> Drive:
        """Returns the drive of the draw, on its own grid or on the shared one."""
        return Drive.of(self.system, shared if self.grid is None else self.grid)


@final
class Stepped(eqx.Module):
    """The readings at the ends of all steps: of the channels and, if they were requested, of the
    plate's elements and of the sides of the cells. `failed` marks draws without a valid solution.
    """

    channels: StepReadings
    elements: StepReadings | None
    sides: StepReadings | None
    failed: Bool[Array, "*chunk"]


@persistent_jit
def prepare_chunk(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " chunk"]],
    inputs: InputSummary,
    initial: CheckedInitial,
    commanded: TimeGrid | None = None,
    precision: Precision = "float64",
) -> Prepared:
    """Computes the systems, the modes and the initial temperatures of a chunk, in float64.

    **Arguments:**

    - `twin`: the twin; parameters that are not drawn keep its values.
    - `draws`: name of a parameter -> its values in the unit of the rig's table.
    - `inputs`: the duty cycles and steps of the run.
    - `initial`: the checked temperatures at the start.
    - `commanded`: the time grid before any delay if the draws differ in the driver's delay, else
      None. The program then serves all runs of the twin, however many steps they take.
    - `precision`: the precision of the result.
    """

    def prepare_draw(values: Mapping[str, Float[Array | np.ndarray, ""]]) -> Prepared:
        system = twin.with_values(values).system(lumped=keeps_symmetry(initial))
        modes = run_modes(system, inputs)
        number = stability_number(system, modes, inputs)
        reference = reference_temperature(system, inputs)
        start = initial_temperatures(system, initial, inputs.first, reference)
        own_grid = None
        if commanded is not None and system.delay is not None:
            own_grid = delayed_time_grid(commanded, system.delay)
        return Prepared(system, modes, start, number, own_grid)

    prepared = jax.vmap(prepare_draw)(draws)
    return prepared if precision == "float64" else in_precision(prepared, precision)


@persistent_jit
def step_chunk(
    prepared: Prepared,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " channels"],
    with_plate: bool,
    with_sides: bool,
) -> Stepped:
    """Computes all steps of a chunk.

    **Arguments:**

    - `grid`: the time grid that the draws share.
    - `columns`: the positions of the requested channels among those of the rig.
    - `with_plate`, `with_sides`: whether the plate's elements and the sides of the cells are read.
    """
    wiring = prepared.system.wiring
    # All elements of the plate are read, also where one node of the lumped network stands for two.
    elements = wiring.rig_elements if with_plate else []
    sides = np.concatenate([wiring.cold, wiring.hot]) if with_sides else []
    nodes = np.array([*elements, *sides], int)

    def step_draw(draw: Prepared) -> Stepped:
        readout = jnp.asarray(draw.system.channel_weights)[columns]
        if len(nodes):
            unit_rows = np.eye(len(wiring.netlist.nodes))[nodes]
            readout = jnp.concatenate([readout, jnp.asarray(unit_rows, readout.dtype)])
        assert draw.modes is not None
        # No derivative is taken here, so that the rounding of the losses does no harm.
        read = integrate(
            draw.system, draw.drive(grid), draw.modes, draw.start, readout, loss_dtype=jnp.float32
        )
        ends = np.cumsum([0, len(columns), len(elements), len(sides)])
        of_channels, of_elements, of_sides = (
            StepReadings(
                read.values[:, first:last], read.slopes[:, first:last], read.error_estimate
            )
            for first, last in pairwise(ends)
        )
        failed = ~(draw.system.is_valid & jnp.all(jnp.isfinite(read.values)))
        return Stepped(
            of_channels,
            of_elements if with_plate else None,
            of_sides if with_sides else None,
            failed,
        )

    return jax.vmap(step_draw)(prepared)


@persistent_jit
def sample_chunk(
    prepared: Prepared,
    stepped: Stepped,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " channels"],
    last: bool = False,
) -> Float[Array, "chunk times channels"]:
    """Computes the temperatures of the channels at all samples, or at the last one, degC; NaN for
    failed draws."""
    which = slice(-1, None) if last else slice(None)

    def sample_draw(draw: Prepared, stepped: Stepped) -> Array:
        drive = draw.drive(grid)
        deviation = stepped.channels.at_samples(drive.grid, which)
        ambient = drive.ambient_at_samples(which)
        reading = draw.system.readings(deviation, ambient, columns)
        celsius = reading + (drive.reference - ZERO_CELSIUS)
        return jnp.where(stepped.failed, jnp.nan, celsius)

    return jax.vmap(sample_draw)(prepared, stepped)


@persistent_jit
def sample_plate_end(
    prepared: Prepared, stepped: Stepped, grid: TimeGrid
) -> Float[Array, "chunk elements"]:
    """Computes the temperatures of the plate's elements at the last sample, K, as deviations from
    the draw's reference; NaN for failed draws."""

    def sample_draw(draw: Prepared, stepped: Stepped) -> Array:
        assert stepped.elements is not None
        elements = stepped.elements.at_samples(draw.drive(grid).grid, slice(-1, None))[0]
        return jnp.where(stepped.failed, jnp.nan, elements)

    return jax.vmap(sample_draw)(prepared, stepped)


@persistent_jit
def sample_power(
    prepared: Prepared,
    stepped: Stepped,
    grid: TimeGrid,
    commands: Float[Array | np.ndarray, "times cells"],
) -> SupplyPower:
    """Computes the power and the energy of the cells; NaN for failed draws.

    **Arguments:**

    - `commands`: the duty cycles from each sample on, -1 to 1.
    """

    def sample_draw(draw: Prepared, stepped: Stepped) -> SupplyPower:
        assert stepped.sides is not None
        drive = draw.drive(grid)
        sides = stepped.sides.at_samples(drive.grid) + drive.reference
        result = supply_power(
            draw.system, sides, grid.times, commands, grid.steady_start, grid.levels_at
        )
        return jax.tree.map(lambda values: jnp.where(stepped.failed, jnp.nan, values), result)

    return jax.vmap(sample_draw)(prepared, stepped)


@persistent_jit
def compressed_errors(
    prepared: Prepared,
    stepped: Stepped,
    recorded: CompressedRecording,
    columns: Int[Array | np.ndarray, " channels"],
) -> Float[Array, "chunk rows channels"]:
    """Computes the errors, simulated minus recorded, in the combinations of samples that the
    compressed recording keeps, K; NaN for failed draws."""

    def draw_errors(system: System, stepped: Stepped) -> Array:
        rows = stepped.channels.at_samples(recorded.grid)
        reading = system.readings(rows, columns=columns)
        offset = system.ambient_temperature - ZERO_CELSIUS
        target = jnp.asarray(recorded.target, reading.dtype)
        error = reading + offset * jnp.asarray(recorded.ones, reading.dtype)[:, None] - target
        return jnp.where(stepped.failed, jnp.nan, error)

    return jax.vmap(draw_errors)(prepared.system, stepped)


@persistent_jit
def compressed_cost(
    errors: Float[Array, "chunk rows channels"], recorded: CompressedRecording
) -> Float[Array, "chunk channels"]:
    """Computes the mean squared error of each channel, K^2."""
    counted, samples, beyond = (
        jnp.asarray(leaf, errors.dtype)
        for leaf in (recorded.counted, recorded.samples, recorded.beyond)
    )
    # As a product: XLA's sums over this axis take twenty times as long in float32 (jax 0.10.2).
    squares = jnp.einsum("dtc,dtc,tc->dc", errors, errors, counted, precision="highest")
    return squares / samples + beyond
