"""Bootstrap resamples of blocks, as weights: the mean over a resample is then a matrix product."""

import numpy as np
from jaxtyping import Float

from .._normal_distribution import QUANTILE_975

# The number of bootstrap resamples: that of SALib.
RESAMPLES = 100


def resample_weights(blocks: int, seed: int) -> Float[np.ndarray, "resamples blocks"]:
    """Returns the weights of the blocks in each resample: the number of times that a block is
    drawn, divided by the number of blocks.

    Seeds other than 0 draw the resamples that SALib's analyser of Sobol's indices draws.
    """
    chosen = np.random.default_rng(seed).integers(blocks, size=(blocks, RESAMPLES))
    return np.stack([np.bincount(column, minlength=blocks) for column in chosen.T]) / blocks


def half_width(resampled: Float[np.ndarray, "resamples *shape"]) -> Float[np.ndarray, "*shape"]:
    """Computes half of the 95 % interval of an index from its resamples: SALib's `*_conf`."""
    return QUANTILE_975 * resampled.std(axis=0, ddof=1)
