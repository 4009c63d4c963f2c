"""Samples that a recording does not have (NaN): curves have gaps there, numbers go without them."""

import numpy as np
from jaxtyping import Float


def mean_of_seen(values: Float[np.ndarray, "times channels"]) -> Float[np.ndarray, " times"]:
    """Mean of the channels that have a sample at each time; NaN where none has."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    total = np.where(there, values, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def last_seen(
    values: Float[np.ndarray, "times channels"], samples: int
) -> Float[np.ndarray, " channels"]:
    """Mean of the last samples of each channel, where the label at its curve's end belongs; 0 for a
    channel without any."""
    ends = []
    for series in values.T:
        seen = series[np.isfinite(series)]
        ends.append(float(seen[-max(1, samples) :].mean()) if len(seen) else 0.0)
    return np.array(ends)


def filled(series: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """The series with its mean where it has no sample: there it adds nothing to an autocorrelation,
    whose spread for white noise is that of a whole series (Parzen 1963)."""
    there = np.isfinite(series)
    return np.where(there, series, series[there].mean() if there.any() else 0.0)
