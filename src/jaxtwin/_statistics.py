r"""Statistics: the agreement of a simulation with a recording, tests of residuals, normal
quantiles.

The test of residuals is that of Ljung and Box (1978): of $n$ residuals with sample autocorrelations
$\rho_k$,

$$Q = n (n + 2) \sum_{k=1}^{h} \frac{\rho_k^2}{n - k}$$

is distributed as $\chi^2$ with $h$ degrees of freedom if they are white. For a series with missing
samples (NaN), $n$ is the number of existing samples, and $n - k$ is replaced by the number of
existing pairs at the lag $k$ (Stoffer and Toloi 1992).
"""

from collections.abc import Iterable
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


# Measures of the agreement between a simulation and a recording. Missing samples (NaN) are left
# out.


def fit_percent(
    recorded: Float[np.ndarray, "*shape times channels"],
    simulated: Float[np.ndarray, "*shape times channels"],
) -> Float[np.ndarray, "*shape channels"]:
    r"""NRMSE fit of each channel, %:
    $100 (1 - \lVert y - \hat y \rVert_2 / \lVert y - \bar y \rVert_2)$.

    100 is a perfect fit, and 0 is the fit of a constant prediction, the channel's mean. The fit is
    NaN for a channel that never changes or whose samples are all missing, for which it is not
    defined.
    """
    there = ~np.isnan(recorded)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.sum(recorded, axis=-2, keepdims=True, where=there) / there.sum(-2, keepdims=True)
        error = np.linalg.norm(np.where(there, recorded - simulated, 0.0), axis=-2)
        scatter = np.linalg.norm(np.where(there, recorded - mean, 0.0), axis=-2)
        # Because of rounding, the mean of equal numbers may differ from them.
        first = np.where(there, recorded, -np.inf).max(axis=-2)
        constant = first == np.where(there, recorded, np.inf).min(axis=-2)
        return 100 * (1 - error / np.where(constant, np.nan, scatter))


def mean_fit_percent(fits: Iterable[float]) -> float:
    """Mean of the fits of several channels, %, without constant ones; NaN if all are constant."""
    defined = [fit for fit in fits if not np.isnan(fit)]
    return float(np.mean(defined)) if defined else float("nan")


def fit_text(percent: float, unit: str = "") -> str:
    """A channel's fit for tables and pictures; a word for a constant channel, which has no fit."""
    return "constant" if np.isnan(percent) else f"{percent:.1f}{unit}"


def rmse(recorded: Float[np.ndarray, "*shape"], simulated: Float[np.ndarray, "*shape"]) -> float:
    """Root of the mean squared error over all samples and channels, K."""
    return float(np.sqrt(np.mean((recorded - simulated) ** 2, where=~np.isnan(recorded))))


# Quantiles of the standard normal distribution.

# The 0.975 quantile: the number of standard deviations on each side of a 95 % interval.
QUANTILE_975 = 1.959963984540054


def normal_quantiles(count: int) -> Float[np.ndarray, " count"]:
    """The expected values of `count` sorted samples of a standard normal distribution (Blom
    1958)."""
    from scipy.special import ndtri  # takes a while to import

    return ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
