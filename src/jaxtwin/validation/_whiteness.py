r"""Whether residuals are white: what a perfect twin would leave is the camera's noise alone.

The test is that of Ljung and Box (1978): of $n$ residuals with sample autocorrelations $\rho_k$,

$$Q = n (n + 2) \sum_{k=1}^{h} \frac{\rho_k^2}{n - k}$$

is distributed as $\chi^2$ with $h$ degrees of freedom where they are white. Of a series with
missing samples (NaN) $n$ are there, and in place of $n - k$ stands how many pairs are there at the
lag $k$ (Stoffer and Toloi 1992).
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

LAGS = 20
"""Of the test; fewer in short series."""


@final
@dataclass(frozen=True)
class Whiteness:
    """A channel's residuals against white noise.

    - `statistic`: $Q$. `lags`: $h$.
    - `p_value`: how likely white noise would have a larger one. Below 0.01 the residuals still hold
      something that could be described.
    - `autocorrelation_time`: how many samples count as one, because they do not vary
      independently.
    """

    statistic: float
    lags: int
    p_value: float
    autocorrelation_time: float

    @property
    def is_white(self) -> bool:
        """Whether the test finds nothing, at 1 %."""
        return self.p_value >= 0.01


def whiteness(residuals: Float[np.ndarray, " times"]) -> Whiteness:
    """Ljung and Box's test of equally spaced residuals, less their mean; NaN where one is missing.

    **Raises:** `ValueError` for fewer than ten samples that are there.
    """
    from scipy.stats import chi2  # takes a while to import

    from ..matching import estimate_noise

    samples = int(np.count_nonzero(~np.isnan(residuals)))
    if samples < 10:
        raise ValueError(f"found {samples} samples, allowed are at least 10")
    lags = min(LAGS, samples // 5)
    sums, pairs = _products(residuals, lags)
    rho = sums[1:] / sums[0] if sums[0] > 0 else np.zeros(lags)
    told = pairs[1:] > 0
    statistic = samples * (samples + 2) * float(np.sum(rho[told] ** 2 / pairs[1:][told]))
    return Whiteness(
        statistic=statistic,
        lags=int(told.sum()),
        p_value=float(chi2.sf(statistic, told.sum())),
        autocorrelation_time=estimate_noise(
            [_about_mean(residuals)[:, None]], samples
        ).autocorrelation_time,
    )


def autocorrelation(
    residuals: Float[np.ndarray, " times"], lags: int
) -> Float[np.ndarray, " lags_and_zero"]:
    """Sample autocorrelations at the lags 0 to `lags`; zeros where nothing varies.

    Missing samples (NaN) are left out: each lag is the mean over the pairs that are there, times
    the share of pairs that a complete series has.
    """
    sums, pairs = _products(residuals, lags)
    if sums[0] <= 0:
        return np.zeros(lags + 1)
    complete = 1 - np.arange(lags + 1) / len(residuals)
    means = np.divide(sums, pairs, out=np.zeros_like(sums), where=pairs > 0)
    return complete * means / means[0]


def _products(
    residuals: Float[np.ndarray, " times"], lags: int
) -> tuple[Float[np.ndarray, " lags_and_zero"], Float[np.ndarray, " lags_and_zero"]]:
    """Sums of products of two residuals at the lags 0 to `lags`, and how many pairs each has."""
    there = (~np.isnan(residuals)).astype(float)
    sums, pairs = (
        np.fft.irfft(np.abs(np.fft.rfft(one, 2 * len(one))) ** 2, 2 * len(one))[: lags + 1]
        for one in (_about_mean(residuals), there)
    )
    if np.nanmax(residuals) == np.nanmin(residuals):
        sums = np.zeros_like(sums)
    return sums, np.rint(pairs)


def _about_mean(residuals: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Less their mean; 0 where one is missing."""
    return np.nan_to_num(residuals - np.nanmean(residuals))


def normal_quantiles(count: int) -> Float[np.ndarray, " count"]:
    """Where `count` sorted samples of a standard normal distribution are expected (Blom 1958)."""
    from scipy.special import ndtri

    return ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
