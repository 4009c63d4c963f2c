"""A test of residuals for whiteness: those of a perfect twin would be only the camera's noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from .._residual_statistics import about_mean, ljung_box
from ..matching import estimate_noise


@final
@dataclass(frozen=True)
class Whiteness:
    """The result of a test of whiteness of a channel's residuals.

    - `statistic`: $Q$. `lags`: $h$.
    - `p_value`: the probability that white noise has a larger statistic. Below 0.01 the residuals
      contain something that a better model could describe. Beside other channels of a recording it
      is Holm's adjusted value, so that all channels together are called not white in 1 % of
      recordings whose residuals are white, however many channels there are.
    - `autocorrelation_time`: the number of samples with the information of one independent sample.
    """

    statistic: float
    lags: int
    p_value: float
    autocorrelation_time: float

    @property
    def is_white(self) -> bool:
        """Whether the test does not reject whiteness at the level of 1 %."""
        return self.p_value >= 0.01


def whiteness(residuals: Float[np.ndarray, " times"]) -> Whiteness:
    """Ljung and Box's test of equally spaced residuals about their mean; NaN for missing samples.

    **Raises:** `ValueError` for fewer than ten samples.
    """
    test = ljung_box(residuals)
    samples = int(np.count_nonzero(~np.isnan(residuals)))
    return Whiteness(
        *test,
        autocorrelation_time=estimate_noise(
            [about_mean(residuals)[:, None]], samples
        ).autocorrelation_time,
    )


def whiteness_of_channels(residuals: Float[np.ndarray, "times channels"]) -> list[Whiteness]:
    """The tests of the channels of a recording, with Holm's adjusted p-values (Holm 1979), which
    hold whatever the channels have in common.

    **Raises:** `ValueError` for fewer than ten samples in a channel.
    """
    tests = [whiteness(series) for series in residuals.T]
    adjusted = holm_adjusted([test.p_value for test in tests])
    return [replace(test, p_value=p) for test, p in zip(tests, adjusted, strict=True)]


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """The smallest level at which Holm's procedure rejects each of several hypotheses, with the
    probability of any false rejection below that level."""
    order = np.argsort(p_values)
    factors = np.arange(len(order), 0, -1)
    rising = np.maximum.accumulate(factors * np.asarray(p_values, float)[order])
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(rising, 1.0)
    return adjusted.tolist()
