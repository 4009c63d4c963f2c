"""The history of a rig in a fixed amount of memory: the lowest, highest and mean reading of each
time interval, and the last estimates in it, in intervals of three lengths."""

import threading
from collections.abc import Sequence
from typing import Any, final

import numpy as np
from jaxtyping import Float, Int

from .._json_values import json_value
from ..observers import Estimate
from ._contents import significant

# The lengths of the intervals, s, and their numbers: an hour, a day and a week.
LEVELS = ((1.0, 3600), (10.0, 8640), (60.0, 10_080))

# The largest number of intervals of an answer, which is that of the pixels of a chart.
MAX_POINTS = 600


# What is kept of the uncertain parameters: the estimate, and the edges of its 95 % band.
PARAMETERS = ("parameter", "parameter_lower", "parameter_upper")


@final
class History:
    """Keeps what is drawn over time: readings, what was expected of them, duty, and uncertain
    parameters of the twin.

    **Arguments:**

    - `channels`: the number of channels.
    - `cells`: the number of cells and heaters.
    - `levels`: the lengths of the intervals, s, and their numbers.
    """

    def __init__(self, channels: int, cells: int, levels: Sequence[tuple[float, int]] = LEVELS):
        self._levels = tuple(_Level(width, size, channels, cells) for width, size in levels)
        self._lock = threading.Lock()
        self._first: float | None = None
        self._last = 0.0
        self._parameters: tuple[str, ...] = ()

    def follow(self, parameters: Sequence[str]) -> None:
        """Goes on with the uncertain parameters of another twin. What is known of those that it
        shares with the one before is kept."""
        with self._lock:
            before = self._parameters
            places = [before.index(name) if name in before else -1 for name in parameters]
            self._parameters = tuple(parameters)
            for level in self._levels:
                level.follow(np.array(places, int))

    def add(
        self,
        time: float,
        readings: Float[np.ndarray, " channels"],
        expected: Float[np.ndarray, " channels"],
        band: Float[np.ndarray, " channels"],
        duty: Float[np.ndarray, " cells"],
        parameters: Estimate | None = None,
    ) -> None:
        """Adds a sample.

        **Arguments:**

        - `time`: s since 1970.
        - `readings`, `expected`: what was measured, and what was expected of it, degC; NaN where
          there is none.
        - `band`: half the width of the 95 % band of the latter, K.
        - `duty`: the duty of the cells, -1 to 1.
        - `parameters`: the uncertain parameters; None while nothing is known of them.
        """
        with self._lock:
            self._first = time if self._first is None else min(self._first, time)
            self._last = max(self._last, time)
            for level in self._levels:
                level.add(time, readings, expected, band, duty, parameters)

    def over(self, span: float, points: int = MAX_POINTS) -> dict[str, Any]:
        """Returns the last `span` seconds in at most `points` intervals, by the finest level that
        reaches back so far.

        **Returns:** `width`, the length of an interval, s; `time`, their beginnings, s since 1970,
        without those in which nothing was measured; `low`, `high`, `mean`, `expected` and `band`, a
        list for each channel; `duty`, a list for each cell; `parameter`, `parameter_lower` and
        `parameter_upper`, a list for each uncertain parameter. None is a missing number.
        """
        with self._lock:
            if self._first is None:
                return self._levels[0].between(0.0, 0.0, points)
            since = max(self._last - span, self._first)
            level = next(
                (level for level in self._levels if level.reach >= self._last - since),
                self._levels[-1],
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
        # Estimate, lower and upper edge of its band.
        self._parameters = np.full((3, size, 0), np.nan, np.float32)

    def follow(self, places: Int[np.ndarray, " parameters"]) -> None:
        """Takes other parameters: those that had a column keep it, the others (-1) begin."""
        kept = np.full((3, self._size, len(places)), np.nan, np.float32)
        kept[:, :, places >= 0] = self._parameters[:, :, places[places >= 0]]
        self._parameters = kept

    def add(
        self,
        time: float,
        readings: np.ndarray,
        expected: np.ndarray,
        band: np.ndarray,
        duty: np.ndarray,
        parameters: Estimate | None,
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
            self._parameters[:, slot] = np.nan
        valid = np.isfinite(readings)
        self._low[slot] = np.fmin(self._low[slot], readings)
        self._high[slot] = np.fmax(self._high[slot], readings)
        self._sum[slot] += np.where(valid, readings, 0.0)
        self._count[slot] += valid
        self._expected[slot], self._band[slot], self._duty[slot] = expected, band, duty
        if parameters is not None:
            self._parameters[:, slot] = parameters

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
            **{
                name: significant(table[at_ends].T)
                for name, table in zip(PARAMETERS, self._parameters, strict=True)
            },
        }


def _columns(values: np.ndarray, digits: int) -> list[list[float | None]]:
    """A list for each column; JSON has no NaN."""
    return json_value(np.round(values.astype(float), digits).T)
