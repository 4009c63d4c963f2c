"""The noise of residuals: its standard deviation and its autocorrelation time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True)
class Noise:
    """The noise of residuals of one kind, over all recordings.

    - `standard_deviation`: the standard deviation of a single sample, K.
    - `autocorrelation_time`: the integrated autocorrelation time in samples, 1 plus twice the sum
      of the autocorrelations: the number of samples with the information of one independent sample.
    """

    standard_deviation: float
    autocorrelation_time: float

    @property
    def effective(self) -> float:
        """Standard deviation of independent samples with the same information, K."""
        return self.standard_deviation * float(np.sqrt(self.autocorrelation_time))


def estimate_noise(
    series: Sequence[Float[np.ndarray, "_times _channels"]], samples: float | int | None = None
) -> Noise:
    """Estimates standard deviation and autocorrelation time of several series of residuals about
    zero.

    The sum of autocorrelations ends before the first two neighbours whose sum is not positive
    (Geyer 1992, initial positive sequence), because later ones are only noise.

    **Arguments:**

    - `series`: a series for each recording, times the square roots of the samples' weights.
    - `samples`: the sum of these weights; by default all are 1.
    """
    longest = max(len(residuals) for residuals in series)
    covariances = np.zeros(longest)
    counted = sum(residuals.size for residuals in series) if samples is None else samples
    for residuals in series:
        times = len(residuals)
        padded = np.fft.rfft(residuals, 2 * times, axis=0)
        covariances[:times] += np.fft.irfft(np.abs(padded) ** 2, axis=0)[:times].sum(axis=1)
    if covariances[0] <= 0:
        return Noise(0.0, 1.0)
    pairs = (covariances[: longest // 2 * 2] / covariances[0]).reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    total = 2 * pairs[: ends[0] if ends.size else len(pairs)].sum() - 1
    return Noise(float(np.sqrt(covariances[0] / counted)), float(max(1.0, total)))
