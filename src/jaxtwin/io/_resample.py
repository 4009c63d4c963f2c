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

Samples are added in blocks, so that a recording of any length needs only the memory of its grid.
"""

from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

# The run of a bin without samples, and of one with samples of several runs.
NONE, MIXED = -1, -2


@final
class BinMeans:
    """The means within half a step of each grid time.

    **Arguments:**

    - `grid`: the grid times, evenly spaced by `step`, s.
    - `step`: the step of the grid, s.
    - `columns`: the number of columns of the values.
    """

    def __init__(self, grid: Float[np.ndarray, " grid"], step: float, columns: int):
        self._start, self._step = grid[0], step
        self._sums = np.zeros((len(grid), columns))
        self._counts = np.zeros((len(grid), columns), np.int32)
        self._runs = np.full(len(grid), NONE, np.int32)

    def add(
        self,
        time: Float[np.ndarray, " samples"],
        values: Float[np.ndarray, "samples columns"],
        run: Int[np.ndarray, " samples"],
    ) -> None:
        """Adds samples in any order.

        **Arguments:**

        - `time`: the times of the samples, s.
        - `values`: the values of the samples; NaN is left out.
        - `run`: the number of the run to which each sample belongs.
        """
        place = np.floor((time - self._start) / self._step + 0.5).astype(np.int64)
        inside = (place >= 0) & (place < len(self._sums))
        place, values, run = place[inside], values[inside], run[inside]
        if not len(place):
            return
        first, length = place.min(), np.ptp(place) + 1
        part = slice(first, first + length)
        there = ~np.isnan(values)
        for column in range(values.shape[1]):
            weights = np.where(there[:, column], values[:, column], 0.0)
            solution = there[:, column].astype(np.float64)
            self._sums[part, column] += np.bincount(place - first, weights, length)
            counts = np.bincount(place - first, solution, length)
            self._counts[part, column] += counts.astype(np.int32)
        for number in np.unique(run):
            own = place[(run == number) & there.any(axis=1)]
            before = self._runs[own]
            self._runs[own] = np.where((before == NONE) | (before == number), number, MIXED)

    def result(self) -> Float[np.ndarray, "grid columns"]:
        """The means; NaN for bins without samples, or with samples of several runs. It is made in
        the place of the sums, and can be taken once."""
        with np.errstate(invalid="ignore"):  # 0 / 0 is NaN
            np.divide(self._sums, self._counts, out=self._sums)
        self._sums[self._runs == MIXED] = np.nan
        return self._sums


@final
class ZeroOrderHold:
    """The last value at or before each of several times.

    **Arguments:**

    - `when`: the requested times, increasing, s.
    - `columns`: the number of columns of the values.
    """

    def __init__(self, when: Float[np.ndarray, " grid"], columns: int):
        self._when = when
        self._time = np.full(len(when), -np.inf)
        self._values = np.zeros((len(when), columns))

    def add(
        self, time: Float[np.ndarray, " samples"], values: Float[np.ndarray, "samples columns"]
    ) -> None:
        """Adds samples in increasing order of their times (s), beginning before or after those that
        were added already."""
        # The last sample before each requested time, if it is later than what was found before.
        place = np.searchsorted(self._when, time, side="left")
        last = np.append(place[1:] != place[:-1], True)
        place, time, values = place[last], time[last], values[last]
        later = place < len(self._when)
        later[later] = time[later] > self._time[place[later]]
        self._time[place[later]] = time[later]
        self._values[place[later]] = values[later]

    def result(
        self, longest: float
    ) -> tuple[Float[np.ndarray, "grid columns"], Bool[np.ndarray, " grid"]]:
        """The values, and whether each is at most `longest` seconds old."""
        solution = np.where(np.isfinite(self._time), np.arange(len(self._time)), 0)
        last = np.maximum.accumulate(solution)
        age = self._when - self._time[last]
        return self._values[last], age <= longest
