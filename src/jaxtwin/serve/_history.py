"""The history of a rig in a fixed amount of memory: the lowest, highest and mean reading of each
time interval, in intervals of three lengths."""

import threading
from typing import Any, final

import numpy as np
from jaxtyping import Float

from .._json_values import json_value

LEVELS = ((1.0, 3600), (10.0, 8640), (60.0, 10_080))
"""The lengths of the intervals, s, and their numbers: an hour, a day and a week."""

MOST_POINTS = 600
"""The largest number of intervals of an answer, which is that of the pixels of a chart."""


@final
class History:
    """Keeps what is drawn over time: readings, what was expected of them, and duty.

    **Arguments:**

    - `channels`: the number of channels.
    - `cells`: the number of cells and heaters.
    """

    def __init__(self, channels: int, cells: int):
        self._levels = tuple(_Level(width, size, channels, cells) for width, size in LEVELS)
        self._lock = threading.Lock()
        self._first: float | None = None
        self._last = 0.0

    def add(
        self,
        time: float,
        readings: Float[np.ndarray, " channels"],
        expected: Float[np.ndarray, " channels"],
        band: Float[np.ndarray, " channels"],
        duty: Float[np.ndarray, " cells"],
    ) -> None:
        """Adds a sample.

        **Arguments:**

        - `time`: s since 1970.
        - `readings`, `expected`: what was measured, and what was expected of it, degC; NaN where
          there is none.
        - `band`: half the width of the 95 % band of the latter, K.
        - `duty`: the duty of the cells, -1 to 1.
        """
        with self._lock:
            self._first = time if self._first is None else min(self._first, time)
            self._last = max(self._last, time)
            for level in self._levels:
                level.add(time, readings, expected, band, duty)

    def over(self, span: float, points: int = MOST_POINTS) -> dict[str, Any]:
        """Returns the last `span` seconds in at most `points` intervals, by the finest level that
        reaches back so far.

        **Returns:** `width`, the length of an interval, s; `time`, their beginnings, s since 1970,
        without those in which nothing was measured; `low`, `high`, `mean`, `expected` and `band`, a
        list for each channel; `duty`, a list for each cell. None is a missing number.
        """
        with self._lock:
            if self._first is None:
                return self._levels[0].between(0.0, 0.0, points)
            since = max(self._last - span, self._first)
            level = next(
                (one for one in self._levels if one.reach >= self._last - since), self._levels[-1]
            )
            return level.between(since, self._last, points)


@final
class _Level:
    """Intervals of one length: a ring over time."""

    def __init__(self, width: float, size: int, channels: int, cells: int):
        self.reach = width * (size - 1)
        self._width, self._size = width, size
        self._numbers = np.full(size, -1, np.int64)
        self._count = np.zeros((size, channels), np.int32)
        self._low, self._high, self._sum, self._expected, self._band = (
            np.full((size, channels), np.nan, np.float32) for _ in range(5)
        )
        self._duty = np.full((size, cells), np.nan, np.float32)

    def add(
        self,
        time: float,
        readings: np.ndarray,
        expected: np.ndarray,
        band: np.ndarray,
        duty: np.ndarray,
    ) -> None:
        number = int(time // self._width)
        slot = number % self._size
        if self._numbers[slot] > number:  # older than what the ring still holds
            return
        if self._numbers[slot] != number:
            self._numbers[slot] = number
            self._count[slot] = 0
            self._low[slot] = self._high[slot] = np.nan
            self._sum[slot] = 0.0
        valid = np.isfinite(readings)
        self._low[slot] = np.fmin(self._low[slot], readings)
        self._high[slot] = np.fmax(self._high[slot], readings)
        self._sum[slot] += np.where(valid, readings, 0.0)
        self._count[slot] += valid
        self._expected[slot], self._band[slot], self._duty[slot] = expected, band, duty

    def between(self, since: float, until: float, points: int) -> dict[str, Any]:
        first, last = int(since // self._width), int(until // self._width)
        slots = np.flatnonzero((self._numbers >= first) & (self._numbers <= last))
        slots = slots[np.argsort(self._numbers[slots])]
        several = max(1, -(-(last - first + 1) // max(points - 1, 1)))
        groups = self._numbers[slots] // several
        begins = np.flatnonzero(np.diff(groups, prepend=-1))
        ends = np.append(begins[1:], len(slots)) - 1

        def reduced(by: np.ufunc, values: np.ndarray) -> np.ndarray:
            return by.reduceat(values[slots], begins, axis=0) if len(slots) else values[:0]

        count = reduced(np.add, self._count)
        mean = reduced(np.add, self._sum) / np.where(count > 0, count, np.nan)
        at_ends = slots[ends] if len(slots) else slots
        width = self._width * several
        return {
            "width": width,
            "time": (groups[begins] * width).tolist(),
            "low": _columns(reduced(np.fmin, self._low), 2),
            "high": _columns(reduced(np.fmax, self._high), 2),
            "mean": _columns(mean, 3),
            "expected": _columns(self._expected[at_ends], 3),
            "band": _columns(self._band[at_ends], 3),
            "duty": _columns(self._duty[at_ends], 3),
        }


def _columns(values: np.ndarray, digits: int) -> list[list[float | None]]:
    """A list for each column; JSON has no NaN."""
    return json_value(np.round(values.astype(float), digits).T)
