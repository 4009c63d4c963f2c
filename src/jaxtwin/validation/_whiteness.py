r"""Whether residuals are white: what a perfect twin would leave is the camera's noise alone.

The test is that of Ljung and Box (1978): of $n$ residuals with sample autocorrelations $\rho_k$,

$$Q = n (n + 2) \sum_{k=1}^{h} \frac{\rho_k^2}{n - k}$$

is distributed as $\chi^2$ with $h$ degrees of freedom where they are white.
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
    - `correlated`: how many samples count as one, because they do not vary independently.
    """

    statistic: float
    lags: int
    p_value: float
    correlated: float

    @property
    def is_white(self) -> bool:
        """Whether the test finds nothing, at 1 %."""
        return self.p_value >= 0.01


def whiteness(residuals: Float[np.ndarray, " times"]) -> Whiteness:
    """Ljung and Box's test of equally spaced residuals, less their mean.

    **Raises:** `ValueError` for fewer than ten samples.
    """
    from scipy.stats import chi2  # takes a while to import

    from ..matching import noise_of

    samples = len(residuals)
    if samples < 10:
        raise ValueError(f"found {samples} samples, allowed are at least 10")
    lags = min(LAGS, samples // 5)
    rho = autocorrelation(residuals, lags)[1:]
    statistic = samples * (samples + 2) * float(np.sum(rho**2 / (samples - np.arange(1, lags + 1))))
    about_mean = residuals - residuals.mean()
    return Whiteness(
        statistic=statistic,
        lags=lags,
        p_value=float(chi2.sf(statistic, lags)),
        correlated=noise_of([about_mean[:, None]]).correlated,
    )


def autocorrelation(
    residuals: Float[np.ndarray, " times"], lags: int
) -> Float[np.ndarray, " lags_and_zero"]:
    """Sample autocorrelations at the lags 0 to `lags`; zeros where nothing varies."""
    about_mean = residuals - residuals.mean()
    padded = np.fft.rfft(about_mean, 2 * len(about_mean))
    covariance = np.fft.irfft(np.abs(padded) ** 2)[: lags + 1]
    if np.ptp(residuals) == 0:
        return np.zeros(lags + 1)
    return covariance / covariance[0]


def normal_quantiles(count: int) -> Float[np.ndarray, " count"]:
    """Where `count` sorted samples of a standard normal distribution are expected (Blom 1958)."""
    from scipy.special import ndtri

    return ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
