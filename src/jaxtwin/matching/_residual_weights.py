"""The errors of a recording, split into channels, common mode and camera, and the weights of each.

`SplitErrors` and `ResidualWeights` are arrays of NumPy, or of JAX in compiled code, with the
samples that pad a recording; `RecordingErrors` are the errors of one recording as it is.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._padded_rows import padded

AnyArray = np.ndarray | Array
Tree = TypeVar("Tree")


@final
class SplitErrors(NamedTuple):
    """The output errors of a recording in their parts, K, or the residuals that follow from them.

    - `channel`: the errors of each channel, without the common mode.
    - `common_mode`: the weighted mean over the channels, without the camera's common error.
    - `sizes`: the amplitudes of the camera's shapes.
    """

    channel: Float[AnyArray, "*entries times channels"]
    common_mode: Float[AnyArray, "*entries times"]
    sizes: Float[AnyArray, "*entries shapes"]


@final
class ResidualWeights(eqx.Module):
    r"""Weights of one recording, or of several with a leading axis.

    - `channel`: $\sqrt{w_{tc}} / \sigma_i$. `share`: $w_{tc} / \sum_c w_{tc}$.
    - `common_mode`: $\sqrt{w_t} / \sigma_m$.
    - `shapes`: $\Phi$ of the camera's common error. `solve`: the matrix that gives their sizes $b$
      for a common mode. `sizes`: $1 / s_j$.
    """

    channel: Float[AnyArray, "*recordings times channels"]
    share: Float[AnyArray, "*recordings times channels"]
    common_mode: Float[AnyArray, "*recordings times"]
    shapes: Float[AnyArray, "*recordings times shapes"]
    solve: Float[AnyArray, "*recordings shapes times"]
    sizes: Float[AnyArray, "*recordings shapes"]

    def padded(self) -> "ResidualWeights":
        """The weights of one recording, with zeros for padded samples."""
        channel, share, common_mode, shapes = (
            padded(np.asarray(part), 0.0)
            for part in (self.channel, self.share, self.common_mode, self.shapes)
        )
        solve = padded(np.asarray(self.solve).T, 0.0).T
        return ResidualWeights(channel, share, common_mode, shapes, solve, self.sizes)

    def split(self, errors: Float[AnyArray, "*entries times channels"]) -> SplitErrors:
        """Splits the output errors of one recording, or their derivatives, into their parts."""
        # NumPy takes several times as long for a sum over few neighbours.
        mean = (self.share * errors) @ np.ones(self.share.shape[-1])
        sizes = mean @ self.solve.T
        return SplitErrors(errors - mean[..., None], mean - sizes @ self.shapes.T, sizes)

    def weighted(self, errors: Float[AnyArray, "*entries times channels"]) -> SplitErrors:
        """The output errors of one recording, or their derivatives, as residuals in parts."""
        return self.weigh(self.split(errors))

    def weigh(self, parts: SplitErrors) -> SplitErrors:
        """The parts as residuals, in units of their standard deviations."""
        return SplitErrors(
            self.channel * parts.channel,
            self.common_mode * parts.common_mode,
            self.sizes * parts.sizes,
        )


def of_each_recording(function: Callable[..., Tree], errors: AnyArray, *others: Any) -> Tree:
    """The results of a function of one recording for several, with a leading axis: by `jax.vmap`,
    for arrays of NumPy by a loop, which needs no compilation."""
    if not isinstance(errors, np.ndarray):
        return jax.vmap(function)(errors, *others)
    results = [
        function(errors[n], *jax.tree.map(lambda leaf, at=n: np.asarray(leaf[at]), others))
        for n in range(len(errors))
    ]
    return jax.tree.map(lambda *rows: np.stack(rows), *results)


def residual_weights(
    samples: Float[np.ndarray, "times channels"],
    moments: Float[np.ndarray, " times"],
    channel: float,
    common_mode: float,
    shapes: Float[np.ndarray, "times shapes"],
    size_standard_deviations: Float[np.ndarray, " shapes"],
) -> ResidualWeights:
    """Computes the weights of one recording.

    **Arguments:**

    - `samples`: $w_{tc}$, 0 to 1. `moments`: factor on the common mode at each time, 0 to 1.
    - `channel`, `common_mode`: standard deviations of a channel without the common mode, and of the
      common mode times the root of the number of channels, K. If they are equal, all samples have
      equal weights.
    - `shapes`: shapes of the camera's common error. `size_standard_deviations`: prior standard
      deviations of their amplitudes.
    """
    total = samples.sum(axis=1, keepdims=True)
    share = np.divide(samples, total, out=np.zeros_like(samples), where=total > 0)
    weight = moments * total[:, 0] / common_mode**2
    weighted = shapes.T * weight
    normal = weighted @ shapes + np.diag(1 / size_standard_deviations**2)
    return ResidualWeights(
        channel=np.sqrt(samples) / channel,
        share=share,
        common_mode=np.sqrt(weight),
        shapes=shapes,
        solve=np.linalg.solve(normal, weighted),
        sizes=1 / size_standard_deviations,
    )


@final
class RecordingErrors(NamedTuple):
    """Simulated minus recorded temperatures of one recording in three parts, K.

    - `channel`: the errors of each channel, without the common mode.
    - `common_mode`: the mean over the channels, without the camera's error.
    - `camera`: the camera's common error.
    """

    channel: Float[np.ndarray, "times channels"]
    common_mode: Float[np.ndarray, " times"]
    camera: Float[np.ndarray, " times"]

    def mean_over_channels(
        self, weights: Float[np.ndarray, "times channels"]
    ) -> Float[np.ndarray, " times"]:
        """The mean error of all channels, including the camera's error, K.

        Times without counted samples are interpolated: a mean over the other channels would jump
        when a channel begins or ceases to count.
        """
        mean = self.common_mode + self.camera
        if (weights > 0).all():
            return mean
        whole, times = self.channel + mean[:, None], np.arange(len(mean))
        columns = [
            np.interp(times, times[weight > 0], column[weight > 0])
            for column, weight in zip(whole.T, weights.T, strict=True)
            if weight.any()
        ]
        return np.mean(columns, axis=0)
