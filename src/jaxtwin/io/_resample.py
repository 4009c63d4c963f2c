"""Transfers samples with times of their own to the common grid that an `Experiment` needs.

No value is filled in. The rules are:

- The grid is `start + k step`.
- A temperature, or the ambient, is the mean of all readings within half a step of the grid time, if
  these belong to a single run of the recorder.
- The duty of a step is the duty that was applied in the middle of the step, so that the error of a
  switch is half a step at most. A duty is applied from its sample until the next sample, or until
  `longest` after it.
- A temperature without a reading is a missing sample, and so is the ambient.
- A grid time without a duty is left out; it is a gap.
"""

import numpy as np
from jaxtyping import Bool, Float, Int


def bin_means(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples columns"],
    grid: Float[np.ndarray, " grid"],
    step: float,
) -> Float[np.ndarray, "grid columns"]:
    """Computes the means within half a step of each grid time; NaN if there are no samples.

    **Arguments:**

    - `time`: the times of the samples in any order, s.
    - `values`: the values of the samples; NaN is left out.
    - `grid`: the grid times, evenly spaced by `step`, s.
    """
    place = np.floor((time - grid[0]) / step + 0.5).astype(np.int64)
    inside = (place >= 0) & (place < len(grid))
    place, values = place[inside], values[inside]
    there = ~np.isnan(values)
    counts, sums = (
        np.stack([np.bincount(place, column, minlength=len(grid)) for column in table.T], axis=1)
        for table in (there.astype(np.float64), np.where(there, values, 0.0))
    )
    sums = sums.astype(np.float64)  # for empty input bincount returns integers
    return np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)


def bin_means_by_run(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples columns"],
    run: Int[np.ndarray, " samples"],
    grid: Float[np.ndarray, " grid"],
    step: float,
) -> Float[np.ndarray, "grid columns"]:
    """Computes the means of `bin_means`, with NaN for bins that contain samples of two runs.

    **Arguments:**

    - `time`, `values`, `grid`, `step`: as for `bin_means`.
    - `run`: the number of the run to which each sample belongs.
    """
    means = np.full((len(grid), values.shape[1]), np.nan)
    found = np.zeros(len(grid), np.int64)
    for number in np.unique(run):
        own = run == number
        part = bin_means(time[own], values[own], grid, step)
        there = ~np.isnan(part).all(axis=1)
        found += there
        means[there] = part[there]
    means[found > 1] = np.nan
    return means


def zero_order_hold(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples columns"],
    when: Float[np.ndarray, " grid"],
    longest: float,
) -> tuple[Float[np.ndarray, "grid columns"], Bool[np.ndarray, " grid"]]:
    """Returns the last value at or before each time, and whether it is at most `longest` seconds
    old.

    **Arguments:**

    - `time`: the times of the samples, increasing, s.
    - `values`: the values of the samples.
    - `when`: the requested times, s.
    - `longest`: the longest age of a value, s.
    """
    last = np.searchsorted(time, when, side="right") - 1
    there = last >= 0
    last = np.maximum(last, 0)
    there &= when - time[last] <= longest
    return values[last], there
