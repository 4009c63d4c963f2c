"""Bootstrap resamples of blocks, as weights: what is a mean over blocks is then a product."""

import numpy as np
from jaxtyping import Float

from .._normal_distribution import QUANTILE_975

RESAMPLES = 100
"""The number of bootstrap resamples: that of SALib."""


def resample_weights(blocks: int, seed: int) -> Float[np.ndarray, "resamples blocks"]:
    """The weights of the blocks in each resample: how often a block is drawn, divided by their
    number.

    Seeds other than 0 draw the resamples that SALib's analyser of Sobol's indices draws.
    """
    chosen = np.random.default_rng(seed).integers(blocks, size=(blocks, RESAMPLES))
    return np.stack([np.bincount(column, minlength=blocks) for column in chosen.T]) / blocks


def half_width(resampled: Float[np.ndarray, "resamples *shape"]) -> Float[np.ndarray, "*shape"]:
    """Half of a 95 % interval, from an index of each resample: SALib's `*_conf`."""
    return QUANTILE_975 * resampled.std(axis=0, ddof=1)
