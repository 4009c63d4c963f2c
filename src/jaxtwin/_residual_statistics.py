r"""Statistics of residuals: their autocorrelation, and Ljung and Box's test.

The test is that of Ljung and Box (1978): of $n$ residuals with sample autocorrelations $\rho_k$,

$$Q = n (n + 2) \sum_{k=1}^{h} \frac{\rho_k^2}{n - k}$$

is distributed as $\chi^2$ with $h$ degrees of freedom if they are white. For a series with missing
samples (NaN), $n$ is the number of existing samples, and $n - k$ is replaced by the number of
existing pairs at the lag $k$ (Stoffer and Toloi 1992).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# The number of lags in Ljung and Box's test; short series have fewer.
LAGS = 20


class LjungBox(NamedTuple):
    """The result of Ljung and Box's test.

    - `statistic`: $Q$. `lags`: $h$.
    - `p_value`: the probability that white noise has a larger $Q$.
    """

    statistic: float
    lags: int
    p_value: float


def ljung_box(residuals: Float[np.ndarray, " times"]) -> LjungBox:
    """Ljung and Box's test of equally spaced residuals from which their mean was subtracted; NaN
    for missing samples.

    **Raises:** `ValueError` for fewer than ten existing samples.
    """
    from scipy.stats import chi2  # takes a while to import

    samples = int(np.count_nonzero(~np.isnan(residuals)))
    if samples < 10:
        raise ValueError(f"expected at least 10 samples, got {samples}")
    lags = min(LAGS, samples // 5)
    sums, pairs = _products(residuals, lags)
    rho = sums[1:] / sums[0] if sums[0] > 0 else np.zeros(lags)
    known = pairs[1:] > 0
    statistic = samples * (samples + 2) * float(np.sum(rho[known] ** 2 / pairs[1:][known]))
    return LjungBox(statistic, int(known.sum()), float(chi2.sf(statistic, known.sum())))


def autocorrelation(
    residuals: Float[np.ndarray, " times"], lags: int
) -> Float[np.ndarray, " lags_and_zero"]:
    """Sample autocorrelations at the lags 0 to `lags`; zeros for a constant series.

    Missing samples (NaN) are left out: each lag is the mean over the existing pairs, times the
    number of pairs of a complete series divided by its number of samples.
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
    """Sums of products of two residuals at the lags 0 to `lags`, and the number of pairs of each
    lag."""
    there = (~np.isnan(residuals)).astype(float)
    sums, pairs = (
        np.fft.irfft(np.abs(np.fft.rfft(series, 2 * len(series))) ** 2, 2 * len(series))[: lags + 1]
        for series in (about_mean(residuals), there)
    )
    if np.nanmax(residuals) == np.nanmin(residuals):
        sums = np.zeros_like(sums)
    return sums, np.rint(pairs)


def about_mean(residuals: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Subtracts their mean from the residuals; 0 for missing ones."""
    return np.nan_to_num(residuals - np.nanmean(residuals))


def partial_autocorrelation(
    residuals: Float[np.ndarray, " times"], lags: int
) -> Float[np.ndarray, " lags_and_zero"]:
    """Sample partial autocorrelations at the lags 0 to `lags`: the part of each autocorrelation
    that those at smaller lags do not explain (Durbin and Levinson's recursion)."""
    rho = autocorrelation(residuals, lags)
    result = np.zeros(lags + 1)
    result[0] = rho[0]
    weights = np.zeros(0)
    for lag in range(1, lags + 1):
        left = 1 - weights @ rho[1:lag]
        last = (rho[lag] - weights @ rho[lag - 1 : 0 : -1]) / left if left > 0 else 0.0
        weights = np.append(weights - last * weights[::-1], last)
        result[lag] = last
    return result
