"""Means over the samples that are there, for series in which missing ones (NaN) are gaps."""

import numpy as np
from jaxtyping import Float


def mean_there(values: Float[np.ndarray, "rows columns"], axis: int) -> Float[np.ndarray, " kept"]:
    """The mean along an axis; NaN where nothing is there.

    **Arguments:**

    - `values`: NaN where a sample is missing.
    """
    there = ~np.isnan(values)
    counts = there.sum(axis=axis)
    sums = np.sum(values, axis=axis, where=there)
    return np.divide(sums, counts, out=np.full(counts.shape, np.nan), where=counts > 0)


def last_means(
    values: Float[np.ndarray, "times channels"], samples: int
) -> Float[np.ndarray, " channels"]:
    """The mean of the last samples of each channel that are there; NaN where it has none.

    **Arguments:**

    - `samples`: how many; at least one counts.
    """
    ends = [column[~np.isnan(column)][-max(1, samples) :] for column in values.T]
    return np.array([end.mean() if end.size else np.nan for end in ends])
