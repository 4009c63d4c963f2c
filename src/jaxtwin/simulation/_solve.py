"""A network through a whole schedule: the loop over exponential steps and what is read from it."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..physics import System
from ._actuator import lagged_duty
from ._ambient import ambient_of_steps, reference_temperature
from ._delay import delayed_schedule
from ._exponential import Inputs, ModalField, exponential_step, step_factors
from ._modes import Modes, left_coupling, network_modes
from ._resolution import LARGEST_SPAN, network_span, spanned
from ._schedule import Schedule

STIFF = 1.0
"""Of `coupling_left`: from here on the steps are too long."""

SLOPE_WEIGHT = 0.15
"""Largest weight of a slope between the ends of a step, in lengths of the step."""

DOUBTFUL = 2e-3
"""Of a solution's doubt, K: from here on its error may pass 1e-3 K. Of a thousand draws between all
bounds of each bundled rig, none with less doubt did."""


@final
class StepReadings(eqx.Module):
    """What is read at the ends of steps: weighted sums of node temperatures and their slopes.

    Deviations from the reference, K, and K/s. Row k belongs to the start of step k.
    `doubt` is the largest that the doubts of all steps so far add up to in any channel, at the end
    of a step or within, K.
    """

    values: Float[Array, "*chunk ends outputs"]
    slopes: Float[Array, "*chunk ends outputs"]
    doubt: Float[Array, "*chunk"]

    def at_samples(
        self, schedule: Schedule, which: slice = slice(None)
    ) -> Float[Array, "times outputs"]:
        """Interpolated at the samples, or at some, of the schedule that was solved."""
        values, slopes = self.values, self.slopes
        w = jnp.asarray(schedule.weights, values.dtype)[which, :, None]
        at = jnp.asarray(schedule.step_of)[which]
        before = jnp.maximum(at - 1, 0)
        return (
            w[:, 0] * values[at]
            + w[:, 1] * slopes[at]
            + w[:, 2] * values[at + 1]
            + w[:, 3] * slopes[at + 1]
            + w[:, 4] * values[before]
            + w[:, 5] * slopes[before]
        )


def solve_schedule(
    system: System,
    schedule: Schedule,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    at_rest: bool = False,
) -> Float[Array, "times outputs"]:
    """Runs a network through a schedule.

    **Arguments:**

    - `system`: the equations.
    - `schedule`: steps, inputs and samples.
    - `initial`: absolute node temperatures at the start, K.
    - `readout`: which weighted sums of node temperatures to return.
    - `at_rest`: whether the first duty cycle has been held for ever, which a driver that lags
      behind its command remembers.

    **Returns:** the sums of the nodes' deviations from the reference at each sample, K.
    The reference is `reference_temperature(system, schedule)`.
    """
    modes = schedule_modes(system, schedule)
    schedule = arriving(schedule, system, at_rest)
    return solve_steps(system, schedule, modes, initial, readout, at_rest).at_samples(schedule)


def arriving(schedule: Schedule, system: System, at_rest: bool) -> Schedule:
    """A schedule as the system's cells see it: later than commanded where the driver has a delay.

    See `solve_schedule` for `at_rest`.
    """
    if system.delay is None:
        return schedule
    return delayed_schedule(schedule, system.delay, at_rest)


def solve_steps(
    system: System,
    schedule: Schedule,
    modes: Modes,
    initial: Float[Array, " nodes"],
    readout: Float[Array | np.ndarray, "outputs nodes"],
    at_rest: bool = False,
) -> StepReadings:
    """Runs a network through the steps of a schedule as the cells see it (`arriving`).

    **Arguments:** as those of `solve_schedule`, and the system's `modes` (`schedule_modes`).
    """
    dtype = modes.rates.dtype
    reference = reference_temperature(system, schedule)
    field = ModalField.of(system, modes, reference)
    factors = step_factors(modes.rates, jnp.asarray(schedule.sizes, dtype))
    duty = jnp.asarray(schedule.duty, dtype)
    if system.lag is not None:
        steps = jnp.asarray(schedule.sizes, dtype)[schedule.size]
        starts = jnp.cumsum(steps) - steps
        stages = starts[:, None] + steps[:, None] * jnp.array([0.0, 0.5, 1.0], dtype)
        duty = lagged_duty(system.lag, None, starts, duty, stages, at_rest)
    ambient = ambient_of_steps(system, schedule)

    def advance(state: tuple[Array, Array, Array], step: Any) -> tuple[Any, Any]:
        amplitudes, force, doubt = state
        size, inputs, following = step
        of_size = jax.tree.map(lambda table: table[size], factors)
        amplitudes, new_doubt = exponential_step(amplitudes, force, of_size, field, inputs)
        # The force that starts the next step, under its inputs. Doubt decays as amplitudes do.
        force = field.force(amplitudes, following)
        after = amplitudes, force, of_size.decay * doubt + new_doubt
        return after, after

    inputs = Inputs(duty, ambient)
    at_starts, at_ends = (jax.vmap(lambda row, s=s: row.at(s))(inputs) for s in (0, 2))
    following = jax.tree.map(lambda a, b: jnp.append(a[1:], b[-1:], axis=0), at_starts, at_ends)
    start = modes.amplitudes(initial - reference)
    first_force = field.force(start, jax.tree.map(lambda rows: rows[0], at_starts))
    state = start, first_force, jnp.zeros_like(start)
    _, after = jax.lax.scan(advance, state, (jnp.asarray(schedule.size), inputs, following))
    amplitudes, forces, doubts = jax.tree.map(
        lambda a, b: jnp.append(a[None], b, axis=0), state, after
    )
    # An error in a mode is one in its slope, times its rate: samples between the ends have both.
    lengths = jnp.asarray(schedule.sizes, dtype)[schedule.size]
    doubts = doubts[1:] * (1 + SLOPE_WEIGHT * modes.rates * lengths[:, None])
    read = (jnp.asarray(readout, dtype) @ modes.shapes).T
    channels = (jnp.asarray(system.wiring.channel_weights, dtype) @ modes.shapes).T
    return StepReadings(
        values=amplitudes @ read,
        slopes=(forces - modes.rates * amplitudes) @ read,
        doubt=jnp.abs(doubts @ channels).max(),
    )


def schedule_modes(system: System, schedule: Schedule) -> Modes:
    """The modes with the cells at rest under the schedule's mean duty cycle.

    Their rates, and with them all that is solved, are NaN where float64 cannot tell the slow ones
    beside the fast ones of the network: see `_resolution`.
    """
    dtype = system.capacitance.dtype
    lengths = jnp.asarray(schedule.sizes, dtype)[schedule.size]
    duration = lengths.sum()
    duty = lengths @ jnp.asarray(schedule.duty, dtype) / duration
    modes = network_modes(system, duty, reference_temperature(system, schedule))
    is_resolved = network_span(system, modes.rates[0], duration) <= LARGEST_SPAN
    return eqx.tree_at(lambda m: m.rates, modes, jnp.where(is_resolved, modes.rates, jnp.nan))


def coupling_left(system: System, modes: Modes, schedule: Schedule) -> Float[Array, ""]:
    """`left_coupling` for the schedule's smallest and largest duty cycles and its longest step.

    Infinite where the modes cannot be trusted although the network is one that float64 can carry;
    NaN where it is not, see `_resolution`.
    """
    duty = jnp.asarray(schedule.duty, modes.rates.dtype)
    levels = jnp.stack([duty.min(axis=0), duty.max(axis=0)])
    longest = jnp.max(jnp.asarray(schedule.sizes, modes.rates.dtype))
    reference = reference_temperature(system, schedule)
    coupling = left_coupling(system, modes, levels, reference, longest)
    duration = jnp.asarray(schedule.sizes, modes.rates.dtype)[schedule.size].sum()
    slowest, fastest = modes.rates[0], modes.rates[-1]
    trusted = jnp.isfinite(coupling) & (spanned(fastest, slowest, duration) <= LARGEST_SPAN)
    is_resolved = network_span(system, slowest, duration) <= LARGEST_SPAN
    return jnp.where(is_resolved, jnp.where(trusted, coupling, jnp.inf), jnp.nan)


def too_coarse(
    coupling: Float[Array | np.ndarray, "*draws"],
    doubt: Float[Array | np.ndarray, "*draws"],
    refinement: int,
) -> Bool[np.ndarray, "*draws"]:
    """Whether steps were too long, by `coupling_left` and the solution's doubt.

    Less doubt is accepted of steps that have been halved: where that was needed, errors and doubt
    fall more slowly than they should.

    A solution that did not stay finite, whose doubt is NaN, may be one of steps that were too long.
    A coupling of NaN says that no steps help.
    """
    limit = DOUBTFUL if refinement == 0 else DOUBTFUL / 2
    coupling, doubt = np.asarray(coupling), np.asarray(doubt)
    trusted = (coupling <= STIFF) & (doubt <= limit)
    return np.asarray(~trusted & ~np.isnan(coupling))
