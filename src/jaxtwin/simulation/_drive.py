"""The inputs of a network during a run: the duty that reaches the cells, and the ambient."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics import Conditions, System
from ._delay import delayed_time_grid, lagged_duty
from ._exponential import StepInputs
from ._time_grid import TimeGrid, reference_temperature


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
