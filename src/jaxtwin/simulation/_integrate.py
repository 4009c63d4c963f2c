"""Integrates a network over a run: the loop over exponential steps, and the readings."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from ..physics import System
from ._drive import Drive
from ._exponential import ModalField, decay_functions, exponential_step
from ._interpolation import SLOPE_AT_END
from ._modes import Modes, run_modes
from ._time_grid import TimeGrid

# The readings at the ends of the steps of a run, and at the samples between them.

# The largest weight of a slope within a step, as a multiple of the step size.
SLOPE_WEIGHT = 0.15

# The rate times step size above which a mode is fast: the slope at the end of a step then follows
# from the last stage, see `StepResult`.
FAST_RATE_TIMES_STEP = 16.0


@final
class StepReadings(eqx.Module):
    """Weighted sums of node temperatures, or amplitudes of the modes, at the ends of steps.

    `values` are deviations from the reference, K, and `slopes` are theirs, K/s. Row k belongs to
    the start of step k. `error_estimate` is the largest accumulated error estimate in any channel
    at any time, K.
    """

    values: Float[Array, "*chunk ends outputs"]
    slopes: Float[Array, "*chunk ends outputs"]
    error_estimate: Float[Array, "*chunk"]

    def at_samples(
        self, grid: TimeGrid, which: slice = slice(None)
    ) -> Float[Array, "times outputs"]:
        """Interpolates the sums at all or some of the samples of the grid."""
        values, slopes = self.values, self.slopes
        w = jnp.asarray(grid.weights, values.dtype)[which, :, None]
        at = jnp.asarray(grid.step_of)[which]
        before = jnp.maximum(at - 1, 0)
        return (
            w[:, 0] * values[at]
            + w[:, 1] * slopes[at]
            + w[:, 2] * values[at + 1]
            + w[:, 3] * slopes[at + 1]
            + w[:, 4] * values[before]
            + w[:, 5] * slopes[before]
        )


def largest(estimates: Float[Array, "*shape"]) -> Float[Array, ""]:
    """The largest of several error estimates; NaN if one of them is not finite."""
    # XLA's maximum of several NaN is -inf in some vectorised loops (jax 0.10.2).
    return jnp.where(jnp.all(jnp.isfinite(estimates)), estimates.max(), jnp.nan)


# Integrates a network whose resistances inputs change: each step in the modes of its regime.
#
# Opening a lid changes the modes of a box. A run has few regimes (lid open or closed, fan on or
# off), and the modes of each are found once. A step is taken in the modes of its own regime;
# between two regimes the amplitudes are transformed by $V_2^T C V_1$. Inputs that take many
# values have some of these as regimes, and the difference to the nearest one is part of the
# force (`ModalField`).


def integrate_in_regimes(
    system: System,
    drive: Drive,
    modes: Modes,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    loss_dtype: DTypeLike | None = None,
) -> StepReadings:
    """Integrates over the steps of a drive's grid.

    **Arguments:** those of `integrate`; the `modes` have a leading axis for the regimes.
    """
    dtype, grid = modes.rates.dtype, drive.grid
    fields = jax.vmap(lambda own: ModalField.of(system, own, drive.reference, loss_dtype))(modes)
    sizes = jnp.asarray(grid.sizes, dtype)
    functions = jax.vmap(lambda rates: decay_functions(rates, sizes))(modes.rates)
    inputs, regime = drive.inputs(), nearest_regime(grid)
    at_starts, at_ends = (jax.vmap(lambda row, s=s: row.at(s))(inputs) for s in (0, 2))
    is_held = jnp.any(jnp.asarray(grid.polynomials)[:, SLOPE_AT_END] != 0, axis=1)

    def of(number: Int[Array, ""], tables: Any) -> Any:
        return jax.tree.map(lambda table: table[number], tables)

    def changed(amplitudes: Array, before: Array, after: Array) -> Array:
        """Transforms amplitudes from a regime to another."""
        old, new = modes.shapes[before], modes.shapes[after]
        moved = new.T @ (system.capacitance * (old @ amplitudes))
        return jnp.where(before == after, amplitudes, moved)

    def advance(state: tuple[Array, Array, Array], step: Any) -> tuple[Any, Any]:
        amplitudes, force, error = state
        size, now, following, of_step, next_inputs, is_held = step
        own, field = of(now, modes), of(following, fields)
        of_size = of(size, of(now, functions)).factors()
        end = exponential_step(amplitudes, force, of_size, of(now, fields), of_step)
        after = changed(end.amplitudes, now, following)
        force = field.force(after, next_inputs)
        error = of_size.decay * error + end.error
        # An error of a mode is also an error of its slope, times its rate. Samples inside a step
        # are interpolated from both.
        seen = own.shapes @ (error * (1 + SLOPE_WEIGHT * own.rates * sizes[size]))
        is_fast = (own.rates * sizes[size] > FAST_RATE_TIMES_STEP) & (now == following)
        of_slope = jnp.where(is_held & is_fast, end.last_force, force)
        slopes = field.modes.shapes @ (of_slope - field.modes.rates * after)
        state = after, force, changed(error, now, following)
        return state, (field.modes.shapes @ after, slopes, seen)

    def append(rows: Any, last: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.append(a[1:], b[-1:], axis=0), rows, last)

    first = of(regime[0], fields)
    start = first.modes.amplitudes(initial - drive.reference)
    force = first.force(start, of(jnp.array(0), at_starts))
    following = append(regime, regime)
    steps = jnp.asarray(grid.size), regime, following, inputs, append(at_starts, at_ends), is_held
    _, (after, slopes, seen) = jax.lax.scan(advance, (start, force, jnp.zeros_like(start)), steps)
    before = initial - drive.reference, first.modes.shapes @ (force - first.modes.rates * start)
    values, slopes = (
        jnp.append(one[None], rows, axis=0) @ jnp.asarray(readout, dtype).T
        for one, rows in zip(before, (after, slopes), strict=True)
    )
    errors = seen @ jnp.asarray(system.channel_weights, dtype).T
    return StepReadings(values, slopes, largest(jnp.abs(errors)))


def nearest_regime(grid: TimeGrid) -> Int[Array, " steps"]:
    """The regime that is nearest to the inputs of each step, relative to the range of each input
    over the regimes."""
    regimes, levels = jnp.asarray(grid.regimes), jnp.asarray(grid.levels)
    scale = jnp.ptp(regimes, axis=0)
    weight = jnp.where(scale > 0, 1 / jnp.where(scale > 0, scale, 1.0), 0.0)
    distance = (jnp.abs(levels[:, None] - regimes) * weight).max(axis=-1)
    return jnp.argmin(distance, axis=1)


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
