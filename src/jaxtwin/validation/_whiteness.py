"""A test of residuals for whiteness: those of a perfect twin would be only the camera's noise."""

from dataclasses import dataclass
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
      contain something that a better model could describe.
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
