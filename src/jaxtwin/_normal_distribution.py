"""Quantiles of the standard normal distribution."""

import numpy as np
from jaxtyping import Float

# The 0.975 quantile: the number of standard deviations on each side of a 95 % interval.
QUANTILE_975 = 1.959963984540054


def normal_quantiles(count: int) -> Float[np.ndarray, " count"]:
    """The expected values of `count` sorted samples of a standard normal distribution (Blom
    1958)."""
    from scipy.special import ndtri  # takes a while to import

    return ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
