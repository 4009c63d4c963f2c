"""The readings at the ends of the steps of a run, and at the samples between them."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._time_grid import TimeGrid

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
