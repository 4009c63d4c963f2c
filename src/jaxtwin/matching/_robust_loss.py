"""Huber's robust loss, as weights of the residuals."""

import math

import numpy as np
from jaxtyping import Bool, Float


def huber_weights(
    residuals: Float[np.ndarray, "*shape"], threshold: float, counted: Bool[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Weights that turn least squares into Huber's loss (1964).

    They are 1 up to `threshold` robust standard deviations of the counted samples, and proportional
    to the reciprocal of the residual above. If most of these residuals are 0, there is no scale and
    all weights are 1.
    """
    size = np.abs(residuals)
    scale = 1.4826 * np.median(size[counted]) if counted.any() else 0.0
    if scale == 0:
        return np.ones_like(size)
    return np.minimum(1.0, threshold * scale / np.maximum(size, 1e-300))


def limited_variance(threshold: float) -> float:
    """The variance of a normally distributed number with a standard deviation of 1 that is limited
    to plus and minus `threshold`."""
    tail = 0.5 * math.erfc(threshold / math.sqrt(2))
    density = math.exp(-(threshold**2) / 2) / math.sqrt(2 * math.pi)
    return 1 - 2 * (threshold * density + tail) + 2 * threshold**2 * tail
