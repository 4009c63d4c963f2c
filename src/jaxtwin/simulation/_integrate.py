"""Integrates a network over a run: the loop over exponential steps, and the readings."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..physics import System
from ._drive import Drive
from ._exponential import ModalField, decay_functions, exponential_step
from ._interpolation import SLOPE_AT_END
from ._modes import Modes, run_modes
from ._regimes import integrate_in_regimes
from ._step_readings import FAST_RATE_TIMES_STEP, SLOPE_WEIGHT, StepReadings, largest
from ._time_grid import TimeGrid


def solve_network(
    system: System,
    grid: TimeGrid,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    modes: Modes | None = None,
) -> tuple[Drive, Float[Array, "times outputs"]]:
    """Solves a network for an experiment.

    **Arguments:**

    - `system`: the equations.
    - `grid`: the steps, the commanded inputs and the samples.
    - `initial`: the absolute node temperatures at the start, K.
    - `readout`: the weights of the node temperatures in each sum.
    - `modes`: those that `run_modes` finds, None to find them here.

    **Returns:** the drive of the network, and the sums of the nodes' deviations from its reference
    at each sample, K.
    """
    drive = Drive.of(system, grid)
    modes = run_modes(system, grid.summary()) if modes is None else modes
    readings = integrate(system, drive, modes, initial, readout)
    return drive, readings.at_samples(drive.grid)


def integrate(
    system: System,
    drive: Drive,
    modes: Modes,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"] | None,
    loss_dtype: DTypeLike | None = None,
) -> StepReadings:
    """Integrates over the steps of a drive's grid.

    **Arguments:** those of `solve_network`, the `modes` of the system (`run_modes`), and the
    `loss_dtype` of `ModalField`. A `readout` of None stands for the amplitudes of the modes.
    """
    if drive.grid.regimes is not None:
        assert readout is not None
        return integrate_in_regimes(system, drive, modes, initial, readout, loss_dtype)
    dtype, grid = modes.rates.dtype, drive.grid
    field = ModalField.of(system, modes, drive.reference, loss_dtype)
    functions = decay_functions(modes.rates, jnp.asarray(grid.sizes, dtype))
    inputs = drive.inputs()

    def advance(state: tuple[Array, Array, Array], step: Any) -> tuple[Any, Any]:
        amplitudes, force, error = state
        size, inputs, next_inputs, is_held = step
        of_size = jax.tree.map(lambda table: table[size], functions).factors()
        end = exponential_step(amplitudes, force, of_size, field, inputs)
        # The force that starts the next step, under its inputs. Errors decay as amplitudes do.
        force = field.force(end.amplitudes, next_inputs)
        error = of_size.decay * error + end.error
        is_fast = modes.rates * jnp.asarray(grid.sizes, dtype)[size] > FAST_RATE_TIMES_STEP
        of_slope = jnp.where(is_held & is_fast, end.last_force, force)
        return (end.amplitudes, force, error), (end.amplitudes, of_slope, error)

    at_starts, at_ends = (jax.vmap(lambda row, s=s: row.at(s))(inputs) for s in (0, 2))
    next_inputs = jax.tree.map(lambda a, b: jnp.append(a[1:], b[-1:], axis=0), at_starts, at_ends)
    start = modes.amplitudes(initial - drive.reference)
    first_force = field.force(start, jax.tree.map(lambda rows: rows[0], at_starts))
    state = start, first_force, jnp.zeros_like(start)
    # Where the inputs change, no sample uses the slope at the end of the step before.
    is_held = jnp.any(jnp.asarray(grid.polynomials)[:, SLOPE_AT_END] != 0, axis=1)
    steps = jnp.asarray(grid.size), inputs, next_inputs, is_held
    _, after = jax.lax.scan(advance, state, steps)
    amplitudes, forces, errors = jax.tree.map(
        lambda a, b: jnp.append(a[None], b, axis=0), state, after
    )
    # An error of a mode is also an error of its slope, times its rate. Samples inside a step are
    # interpolated from both.
    lengths = jnp.asarray(grid.sizes, dtype)[grid.size]
    errors = errors[1:] * (1 + SLOPE_WEIGHT * modes.rates * lengths[:, None])
    channel_shapes = (jnp.asarray(system.channel_weights, dtype) @ modes.shapes).T
    error_estimate = largest(jnp.abs(errors @ channel_shapes))
    slopes = forces - modes.rates * amplitudes
    if readout is None:
        return StepReadings(amplitudes, slopes, error_estimate)
    output_shapes = (jnp.asarray(readout, dtype) @ modes.shapes).T
    return StepReadings(amplitudes @ output_shapes, slopes @ output_shapes, error_estimate)
