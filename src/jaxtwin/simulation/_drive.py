"""The inputs of a network during a run: the ambient, and the duty that reaches the cells after the
driver's delay and lag."""

from collections.abc import Iterable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arguments import finite_number
from .._jax_settings import is_traced
from ..errors import JaxtwinError
from ..physics import Conditions, System, Twin
from ._exponential import StepInputs
from ._held_inputs import held_quadratics, mean_of
from ._interpolation import sample_weights, step_polynomials
from ._time_grid import TimeGrid, reference_temperature

# The duty that reaches the cells, after the driver's delay and lag.
#
# Only the inputs depend on time explicitly. For a delay the grid of steps therefore moves with the
# inputs: the steps remain short after each change, and temperatures are smooth functions of the
# delay.
#
# A lag needs no integration. Between two changes of the command $c$, the solution of $\tau \dot u =
# c(t - d) - u$ is $u(t) = c + (u_0 - c) e^{-(t - d - t_0) / \tau}$, at any time.

FINEST, FIRST, GROWN = 2.0**-9, 2.0**-5, 16
GROWING = np.diff([0.0, *np.geomspace(FINEST, FIRST, 5), *np.geomspace(FIRST, 1.0, GROWN + 1)[1:]])
# Steps before the first command arrives, as fractions of the delay. They are short at first,
# because a plate that does not start in a steady state changes fastest then, and grow by a quarter
# each. With fewer steps, the error between their ends is a tenth of a kelvin for a delay of a
# minute. The step of no length at the end is that of `step_polynomials`.
STEPS_BEFORE_COMMAND = np.append(GROWING, 0.0)


def checked_longest_delay(
    where: str,
    longest_delay: float | int | None,
    delay: Float[Array | np.ndarray, ""],
    error: type[JaxtwinError],
) -> float:
    """Returns the longest delay, s, for which a state has commands in transit; by default the
    driver's own.

    **Raises:** `error` if the delay is traced by JAX and `longest_delay` is missing, or if the
    delay is longer.
    """
    if longest_delay is None:
        if is_traced(delay):
            raise error(
                f"{where}: expected a number, in s, because the driver's delay is traced by JAX, "
                "got None"
            )
        return float(delay)
    longest = finite_number(where, longest_delay, error)
    if not is_traced(delay) and not float(delay) <= longest:
        raise error(
            f"{where}: expected at least the driver's delay, {float(delay):g} s, got {longest:g} s"
        )
    return longest


def draws_change_delay(twin: Twin, drawn: Iterable[str]) -> bool:
    """Whether draws of these parameters differ in the driver's delay."""
    delay = twin.wiring.delay
    return delay is not None and not delay.names.isdisjoint(drawn)


def delayed_time_grid(grid: TimeGrid, delay: Float[Array, ""]) -> TimeGrid:
    """Applies a delay to the duty cycles of a time grid.

    A recorded ambient temperature, and the rig's other inputs, have no delay; each step has their
    `held_quadratics`, or their means.

    **Arguments:**

    - `grid`: the time grid with the commanded duty cycles.
    - `delay`: the delay, s, above 0.
    """
    dtype = delay.dtype
    before = len(STEPS_BEFORE_COMMAND)
    sizes = jnp.concatenate(
        [delay * jnp.asarray(STEPS_BEFORE_COMMAND, dtype), jnp.asarray(grid.sizes, dtype)]
    )
    size = jnp.concatenate([jnp.arange(before), before + jnp.asarray(grid.size)])
    duty = jnp.asarray(grid.duty, dtype)
    first = duty[:1] if grid.steady_start else jnp.zeros_like(duty[:1])
    wait = jnp.asarray(step_polynomials([STEPS_BEFORE_COMMAND, np.ones(1)])[:before], dtype)
    polynomials = jnp.asarray(grid.polynomials, dtype)
    # The odd rows are slopes, per second.
    scale = jnp.stack([jnp.ones_like(delay), delay] * 3)
    steps = sizes[size]
    ends = jnp.cumsum(steps)
    starts = ends - steps
    times = jnp.asarray(grid.times, dtype)
    step_of = jnp.clip(jnp.searchsorted(ends, times), 0, size.size - 1)
    # Some steps have no length (`_padding`); their division must not be 0 / 0.
    lengths = jnp.where(steps > 0, steps, 1.0)
    part = (times - starts[step_of]) / lengths[step_of]
    # One table for all draws, whatever their delay.
    weights = sample_weights(jnp.concatenate([wait, polynomials]), step_of, part)
    waiting = (step_of < before)[:, None]

    def during(held: Float[Array | np.ndarray, " times"]) -> Float[Array, "steps 3"]:
        return held_quadratics(times, jnp.asarray(held, dtype), steps, jnp)

    levels_at = grid.levels_at
    return TimeGrid(
        times=grid.times,
        sizes=sizes,
        size=size.astype(np.int32),
        duty=jnp.concatenate([jnp.repeat(first, before, axis=0), duty]),
        ambient=grid.ambient if grid.ambient_at is None else during(grid.ambient_at),
        polynomials=jnp.concatenate([wait * scale[:, None], polynomials]),
        step_of=step_of.astype(np.int32),
        weights=weights * jnp.where(waiting, scale, 1.0),
        ambient_at=grid.ambient_at,
        levels=None
        if levels_at is None
        else jnp.clip(
            jnp.stack([mean_of(during(level)) for level in levels_at.T], axis=1),
            levels_at.min(axis=0),
            levels_at.max(axis=0),
        ),
        levels_at=levels_at,
        regimes=grid.regimes,
        steady_start=grid.steady_start,
        is_delayed=True,
    )


def lagged_duty(
    lag: Float[Array, ""],
    delay: Float[Array, ""] | None,
    starts: Float[Array, " steps"],
    commands: Float[Array, "steps cells"],
    times: Float[Array, "*times"],
    steady_start: bool = False,
) -> Float[Array, "*times cells"]:
    """The duty that reaches the cells at given times, -1 to 1.

    **Arguments:**

    - `lag`, `delay`: the time constant of the lag, and the delay, s.
    - `starts`: the time from which each command is held, increasing, s.
    - `commands`: the commands, -1 to 1.
    - `times`: the times, s.
    - `steady_start`: whether the first command was always held before the start; otherwise the duty
      was 0.
    """
    initial = commands[0] if steady_start else jnp.zeros_like(commands[0])

    def follow(duty: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        command, duration = step
        return command + (duty - command) * jnp.exp(-duration / lag), duty

    durations = jnp.append(jnp.diff(starts), 0.0)
    _, at_start = jax.lax.scan(follow, initial, (commands, durations))
    late = times if delay is None else times - delay
    now = jnp.clip(jnp.searchsorted(starts, late, side="right") - 1, 0)
    # Not the maximum of 0 and the difference, which has half a derivative where both are 0.
    elapsed = jnp.where(late >= starts[now], late - starts[now], 0.0)[..., None]
    return commands[now] + (at_start[now] - commands[now]) * jnp.exp(-elapsed / lag)


@final
class Drive(eqx.Module):
    """The inputs of the network of a draw during a run.

    - `grid`: the steps, the samples, and the inputs that are held during each step, after the
      driver's delay if it has one.
    - `reference`: the temperature from which deviations are counted, K.
    - `lag`: the time constant of the driver's lag, s, or None.
    - `ambient_drift`: the drift of an ambient temperature that is not recorded, K/s, or None.
    - `conditions`: what the rig's other inputs change in each step; None for a rig without any.
    """

    grid: TimeGrid
    reference: Float[Array, ""]
    lag: Float[Array, ""] | None
    ambient_drift: Float[Array, ""] | None
    conditions: Conditions | None

    @classmethod
    def of(cls, system: System, grid: TimeGrid) -> "Drive":
        """Makes the drive of a system from a time grid, whether or not its delay is applied
        already."""
        reference = reference_temperature(system, grid.summary())
        if system.delay is not None and not grid.is_delayed:
            grid = delayed_time_grid(grid, system.delay)
        drift = system.ambient_drift if grid.ambient_at is None else None
        conditions = None
        if grid.levels is not None:
            levels = jnp.asarray(grid.levels, reference.dtype)
            conditions = jax.vmap(system.conditions)(levels)
        return cls(grid, reference, system.lag, drift, conditions)

    def inputs(self) -> StepInputs:
        """The inputs of all steps. If the driver has a lag or the ambient drifts, these are the
        inputs at the start, in the middle and at the end of each step."""
        dtype = self.reference.dtype
        steps = jnp.asarray(self.grid.sizes, dtype)[self.grid.size]
        return StepInputs(self._duty(steps), self._ambient(steps), conditions=self.conditions)

    def ambient_at_samples(self, which: slice = slice(None)) -> Float[Array, "times 1"] | float:
        """The ambient temperature's deviation from the reference at all or some of the samples,
        K."""
        dtype = self.reference.dtype
        if self.grid.ambient_at is not None:
            return (jnp.asarray(self.grid.ambient_at, dtype)[which] - self.reference)[:, None]
        if self.ambient_drift is None:
            return 0.0
        return (self.ambient_drift * jnp.asarray(self.grid.times, dtype)[which])[:, None]

    def _duty(self, steps: Float[Array, " steps"]) -> Float[Array, "steps *stages cells"]:
        duty = jnp.asarray(self.grid.duty, steps.dtype)
        if self.lag is None:
            return duty
        starts = jnp.cumsum(steps) - steps
        stages = starts[:, None] + steps[:, None] * jnp.array([0.0, 0.5, 1.0], steps.dtype)
        return lagged_duty(self.lag, None, starts, duty, stages, self.grid.steady_start)

    def _ambient(self, steps: Float[Array, " steps"]) -> Float[Array, "steps *stages"]:
        if self.grid.ambient is not None:
            return jnp.asarray(self.grid.ambient, steps.dtype) - self.reference
        if self.ambient_drift is None:
            return jnp.zeros_like(steps)
        remaining = steps[:, None] * jnp.array([1.0, 0.5, 0.0], steps.dtype)
        return self.ambient_drift * (jnp.cumsum(steps)[:, None] - remaining)
