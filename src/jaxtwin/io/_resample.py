"""Samples at their own times -> the common grid that an `Experiment` needs.

The rule, and nothing else: nothing is filled in.

- The grid is `start + k step`.
- A temperature, or the ambient, is the mean of all readings within half a step of the grid time,
    where these are of one run of the recorder.
- The duty is the one in force in the middle of the step that it is held for, so that a switch is
    off by half a step at most. It is in force from its sample until the next one, or until
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
    """Means within half a step of each grid time, NaN where there is nothing.

    **Arguments:**

    - `time`: in any order, s.
    - `values`: of the same samples; those that are NaN count nothing.
    - `grid`: evenly spaced by `step`, s.
    """
    place = np.floor((time - grid[0]) / step + 0.5).astype(np.int64)
    inside = (place >= 0) & (place < len(grid))
    place, values = place[inside], values[inside]
    there = ~np.isnan(values)
    counts, sums = (
        np.stack([np.bincount(place, column, minlength=len(grid)) for column in table.T], axis=1)
        for table in (there.astype(np.float64), np.where(there, values, 0.0))
    )
    sums = sums.astype(np.float64)  # of nothing, bincount makes whole numbers
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
    """The last value at or before each time, and where it is at most `longest` seconds old.

    **Arguments:**

    - `time`: increasing, s.
    - `values`: of the same samples.
    - `when`: s.
    - `longest`: s.
    """
    last = np.searchsorted(time, when, side="right") - 1
    there = last >= 0
    last = np.maximum(last, 0)
    there &= when - time[last] <= longest
    return values[last], there
