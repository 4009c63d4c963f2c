"""Whether residuals are white: a perfect twin would leave the camera's noise alone."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from .._residual_statistics import about_mean, ljung_box
from ..matching import estimate_noise


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
    test = ljung_box(residuals)
    samples = int(np.count_nonzero(~np.isnan(residuals)))
    return Whiteness(
        *test,
        autocorrelation_time=estimate_noise(
            [about_mean(residuals)[:, None]], samples
        ).autocorrelation_time,
    )
