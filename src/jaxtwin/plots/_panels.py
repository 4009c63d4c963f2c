"""The grid of panels on which every picture is laid out, what is written around its panels (notes,
legends, captions and scales of colours), and their axis of time: in seconds, minutes, hours or
days, whichever can be read, or with the clock of a recording that has a date.
"""

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, Locator

from ._style import palette, points


def panels(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, np.ndarray]:
    """A new figure with a grid of panels.

    **Arguments:**

    - `width`, `height`: the size of the figure, inches.
    - `options`: those of `Figure.subplots`: the axes that panels share, and their ratios.

    **Returns:** the figure and its panels, `(rows, columns)`.
    """
    figure = pyplot.figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def axes_or_new(ax: Axes | None, width: float, height: float) -> Axes:
    """The given axes, or those of a new figure of this size, inches."""
    return panels(1, 1, width, height)[1].item() if ax is None else ax


def panels_in_rows(
    count: int,
    max_columns: int,
    size: tuple[float, float],
    frame: tuple[float, float],
    **options: Any,
) -> tuple[Figure, list[Axes]]:
    """A figure with a number of panels that share their x axis, row by row.

    **Arguments:**

    - `count`: the number of panels. `max_columns`: the largest number of panels in a row.
    - `size`: the width and height of a panel, inches.
    - `frame`: the width and height of the figure beside its panels, inches.
    - `options`: those of `Figure.subplots`.

    **Returns:** the figure and its panels. The lowest panel of each column has labels below it.
    """
    columns = min(max_columns, count)
    rows = -(-count // columns)
    width, height = frame[0] + size[0] * columns, frame[1] + size[1] * rows
    figure, grid = panels(rows, columns, width, height, sharex=True, **options)
    for axes in grid.flat[max(0, count - columns) : count]:
        axes.tick_params(labelbottom=True)
    for axes in grid.flat[count:]:
        axes.set_axis_off()
    return figure, list(grid.flat[:count])


def without_frame(axes: Axes) -> None:
    """Removes the frame, the grid and the marks of ticks from a panel that is filled with colours;
    the texts of ticks stay."""
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def write(
    axes: Axes,
    text: str,
    at: tuple[Any, Any],
    shift: tuple[float | int, float | int] = (0, 0),
    *,
    size: float | int = 9,
    **look: Any,
) -> None:
    """Writes a note at a point, muted unless another colour is given.

    **Arguments:**

    - `at`: the point, in the units of the axes unless `xycoords` is given.
    - `shift`: the distance of the text from the point, points.
    - `size`: the size of the letters on a screen.
    - `look`: other properties of `Axes.annotate`.
    """
    look = {"color": palette().muted, "fontsize": points(size), **look}
    axes.annotate(text, at, shift, textcoords="offset points", **look)


def write_in_the_middle(axes: Axes, text: str) -> None:
    """Writes in the middle of a panel that has nothing to show."""
    write(axes, text, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center")


def title_aside(axes: Axes, text: str) -> Text:
    """Writes a note at the right end of the line of the title."""
    look = {"fontsize": points(9), "fontweight": "normal", "color": palette().muted}
    return axes.set_title(text, loc="right", **look)


def caption(figure: Figure, text: str) -> None:
    """Writes a note below all panels."""
    figure.supxlabel(text, fontsize=points(9), color=palette().muted, x=0.01, ha="left")


ABOVE_RIGHT = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
"""The place of a legend above axes whose curves would cross it anywhere inside."""


def legend_beside(axes: Axes, *, reverse: bool = False) -> None:
    """Writes the legend to the right of the axes; reversed for lines that were drawn last first."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=points(8), reverse=reverse)


def legend_below(axes: Axes) -> None:
    """Writes the legend below the axes, where it lies on no line."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, fontsize=points(9), frameon=False
    )


Outside = Literal["outside lower center", "outside lower right", "outside upper right"]


def legend_of_all(figure: Figure, loc: Outside = "outside lower center") -> None:
    """Writes one legend outside of all panels, with each of their labels once."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(list(entries.values()), list(entries), loc=loc, ncols=5)


def color_bar(beside: Axes | np.ndarray, scale: ScalarMappable, label: str = "", **size: Any):
    """Draws the bar of a scale of colours beside a panel, or several.

    **Arguments:**

    - `size`: the options of `Figure.colorbar` for its size.

    **Returns:** the bar.
    """
    first = beside if isinstance(beside, Axes) else beside.flat[0]
    bar = first.figure.colorbar(scale, ax=beside, label=label, **size)
    bar.outline.set_visible(False)
    return bar


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
