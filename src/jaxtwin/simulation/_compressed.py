r"""Costs against a recording without a sample in between.

Temperatures at the samples are $W c$, with $c$ the values and slopes at the ends of steps. With
$W = Q R$,

$$\lVert W c - y \rVert^2 = \lVert R c - Q^T y \rVert^2 + \lVert y - Q Q^T y \rVert^2,$$

where $R$ has as many rows as $c$, a fraction of the samples, and is banded as $W$ is.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._interpolation import POWERS
from ._schedule import Schedule
from ._solve import StepReadings


@final
class CompressedRecording(eqx.Module):
    """A recording as seen by the steps of its schedule: constants of a whole sweep.

    - `band`: the diagonals of R, row d the one d places above the main one.
    - `target`: Q^T y, degC, and `ones`: Q^T 1.
    - `beyond`: the mean square of what no temperatures at the ends of steps could follow, K^2.
    - `samples`: how many.
    """

    band: Float[Array | np.ndarray, "diagonals rows"]
    target: Float[Array | np.ndarray, "rows channels"]
    ones: Float[Array | np.ndarray, " rows"]
    beyond: Float[Array | np.ndarray, " channels"]
    samples: int = eqx.field(static=True)

    def mean_square(
        self,
        readings: StepReadings,
        gain: Float[Array, " channels"],
        offset: Float[Array, ""],
    ) -> Float[Array, " channels"]:
        """Mean squared difference of offset + gain times the readings to the recording, K^2."""
        values, slopes = readings.values, readings.slopes
        band = jnp.asarray(self.band, values.dtype)
        count = band.shape[1]
        ends = jnp.stack([values, slopes], axis=1).reshape(count, -1)
        ends = jnp.pad(ends, ((0, len(band) - 1), (0, 0)))
        seen = sum(band[d][:, None] * ends[d : d + count] for d in range(len(band)))
        wanted = jnp.asarray(self.target, values.dtype) - offset * jnp.asarray(
            self.ones, values.dtype
        )[:, None]
        left = jnp.sum((gain * seen - wanted) ** 2, axis=0) / self.samples
        return left + jnp.asarray(self.beyond, values.dtype)


def compress(
    schedule: Schedule, recorded: Float[np.ndarray, "times channels"]
) -> CompressedRecording:
    """The recording of an experiment with a constant ambient, degC, on its schedule."""
    ends = len(schedule.size) + 1
    samples = len(schedule.times)
    weights = np.zeros((samples, 2 * ends))
    at, row = np.asarray(schedule.step_of), np.arange(samples)
    places = [2 * at, 2 * at + 1, 2 * at + 2, 2 * at + 3]
    places += [2 * np.maximum(at - 1, 0), 2 * np.maximum(at - 1, 0) + 1]
    for column, place in enumerate(places):
        weights[row, place] += np.asarray(schedule.weights)[:, column]
    # More rows than columns, also where there are more ends of steps than samples.
    weights = np.pad(weights, ((0, max(0, 2 * ends - samples)), (0, 0)))
    q, r = np.linalg.qr(weights)
    q = q[:samples]
    band = np.stack([np.pad(np.diagonal(r, d), (0, d)) for d in range(POWERS)])
    target = q.T @ recorded
    beyond = np.mean((recorded - q @ target) ** 2, axis=0)
    return CompressedRecording(band, target, q.T @ np.ones(samples), beyond, samples)
