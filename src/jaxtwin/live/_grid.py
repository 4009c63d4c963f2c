"""Samples at their own times -> the common grid that an `Experiment` needs.

The rule, and nothing else: nothing is filled in.

- The grid is `start + k step`.
- A temperature, or the ambient, is the mean of all readings within half a step of the grid time.
- The duty is the one in force in the middle of the step that it is held for, so that a switch is
    off by half a step at most. It is in force from its sample until the next one, or until
    `longest` after it.
- A grid time that lacks any of them is left out; it is a gap.
"""

import numpy as np
from jaxtyping import Bool, Float


def bin_means(
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples columns"],
    grid: Float[np.ndarray, " grid"],
    step: float,
) -> tuple[Float[np.ndarray, "grid columns"], Bool[np.ndarray, " grid"]]:
    """Means within half a step of each grid time, and where there are any.

    **Arguments:**

    - `time`: in any order, s.
    - `values`: of the same samples.
    - `grid`: evenly spaced by `step`, s.
    """
    place = np.floor((time - grid[0]) / step + 0.5).astype(np.int64)
    inside = (place >= 0) & (place < len(grid))
    place, values = place[inside], values[inside]
    counts = np.bincount(place, minlength=len(grid))
    sums = np.stack(
        [np.bincount(place, column, minlength=len(grid)) for column in values.T], axis=1
    )
    there = counts > 0
    return sums / np.maximum(counts, 1)[:, None], there


def held(
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
