"""The axis of time of all pictures: in seconds, minutes, hours or days, whichever can be read, or
with the clock of a recording that has a date."""

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, Locator

MINUTE, HOUR, DAY = 60.0, 3600.0, 86_400.0

# The longest time in a unit -> the unit, s, and its name.
UNITS = ((HOUR, 1.0, "s"), (4 * HOUR, MINUTE, "min"), (4 * DAY, HOUR, "h"), (np.inf, DAY, "days"))

# The distances between two ticks of a clock, s.
STEPS = (
    *(1.0, 2.0, 5.0, 10.0, 15.0, 30.0),
    *(MINUTE * step for step in (1, 2, 5, 10, 15, 30)),
    *(HOUR * step for step in (1, 2, 3, 6, 12)),
)


# The largest number of ticks.
MAX_TICKS = 6


def time_axis(axes: Axes, time: Float[np.ndarray, " times"], start: datetime | None = None) -> None:
    """Makes the x axis that of a time in seconds, from the first to the last.

    **Arguments:**

    - `time`: the times that are drawn, s, of which the first and the last count.
    - `start`: the clock time at 0 s; None: it is not known.
    """
    first, last = float(np.min(time)), float(np.max(time))
    axes.set_xlim(first, last)
    if start is not None:
        axes.xaxis.set_major_locator(_Ticks(start))
        axes.xaxis.set_major_formatter(FuncFormatter(_Clock(axes, start)))
        axes.set_xlabel(_date(start, first, last))
        return
    unit, name = next((unit, name) for longest, unit, name in UNITS if last - first <= longest)
    axes.xaxis.set_major_locator(_Ticks(None, unit))
    axes.xaxis.set_major_formatter(FuncFormatter(_Elapsed(unit)))
    axes.set_xlabel(f"time, {name}")


class _Elapsed(NamedTuple):
    """A time in a unit as text."""

    unit: float

    def __call__(self, value: float, _: int | None = None) -> str:
        return f"{value / self.unit + 0.0:.6g}"  # -0.0 is 0


class _Clock(NamedTuple):
    """A time as that of a clock; midnight as its day."""

    axes: Axes
    start: datetime

    def __call__(self, value: float, _: int | None = None) -> str:
        moment = self.start + timedelta(seconds=round(value, 3))
        low, high = self.axes.get_xlim()
        if high - low > DAY and (moment.hour, moment.minute) == (0, 0):
            return f"{moment.day} {moment:%b}"
        return f"{moment:%H:%M:%S}" if moment.second else f"{moment:%H:%M}"


@final
class _Ticks(Locator):
    """Ticks at round numbers of a unit, or at round times of a clock."""

    def __init__(self, start: datetime | None, unit: float = 1.0):
        self._unit = unit
        # The seconds of the clock at 0 s, counted from a midnight.
        midnight = start and start.replace(hour=0, minute=0, second=0, microsecond=0)
        self._zero = None if start is None else (start - (midnight or start)).total_seconds()

    def __call__(self) -> Sequence[float]:
        assert self.axis is not None
        return self.tick_values(*sorted(self.axis.get_view_interval()))

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        # As many as have room for their texts.
        room = MAX_TICKS if self.axis is None else int(0.8 * self.axis.get_tick_space())
        least = (vmax - vmin) / min(max(room, 2), MAX_TICKS)
        zero = self._zero or 0.0
        if self._zero is None:
            power = 10.0 ** np.floor(np.log10(least / self._unit)) * self._unit
            step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.999 * least)
        else:
            days = DAY * np.ceil(least / DAY)
            step = next((each for each in STEPS if each >= 0.999 * least), float(days))
        margin = 1e-9 * (vmax - vmin)
        numbers = np.arange(
            np.ceil((vmin + zero - margin) / step), np.floor((vmax + zero + margin) / step) + 1
        )
        return self.raise_if_exceeds((numbers * step - zero).tolist())


def _date(start: datetime, first: float, last: float) -> str:
    """The days of a recording, for the label of the axis."""
    begin, end = (start + timedelta(seconds=each) for each in (first, last))
    whole = f"{begin.day} {begin:%b %Y}"
    if begin.date() == end.date():
        return f"time of {whole}"
    return f"time, from {whole} to {end.day} {end:%b %Y}"
