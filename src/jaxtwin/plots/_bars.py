"""The layers of pictures of parameters: rows with their names, bars from 0, estimates with their
intervals, and matrices of numbers.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from ._panels import without_frame
from ._style import INK, PALE, palette, points, symbol


def draw_bars(
    axes: Axes,
    names: Sequence[str],
    values: Float[np.ndarray, " parameters"],
    interval: tuple[np.ndarray, np.ndarray] | None = None,
) -> Float[np.ndarray, " parameters"]:
    """Draws a bar for each parameter, the first on top, those below 0 in blue.

    **Arguments:**

    - `interval`: the lower and the upper ends of the intervals, which are lines.

    **Returns:** the places of the bars on the vertical axis.
    """
    places = np.arange(len(names), dtype=float)[::-1]
    colors = [palette().blue if value < 0 else palette().vermilion for value in values]
    axes.barh(places, values, color=colors, height=0.66, alpha=0.9)
    if interval is not None and np.isfinite(interval).any():
        axes.hlines(places, *interval, color=palette().ink, lw=1.3)
    label_rows(axes, names, places)
    return places


def label_rows(axes: Axes, names: Sequence[str], places: Float[np.ndarray, " parameters"]) -> None:
    """Writes the parameters beside their bars, which begin at a line at 0."""
    axes.axvline(0.0, color=palette().muted, lw=0.8)
    axes.set_yticks(places, [symbol(name) for name in names], fontsize=points(10))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)


def name_rows(axes: Axes, names: Sequence[tuple[str, bool]]) -> None:
    """Writes names beside rows, the first on top.

    **Arguments:**

    - `names`: each name, and whether it is bold.
    """
    axes.set_yticks(range(len(names)), [name for name, _ in names])
    for label, (_, is_bold) in zip(axes.get_yticklabels(), names, strict=True):
        label.set_fontweight("bold" if is_bold else "normal")
    axes.invert_yaxis()


def draw_estimates(
    axes: Axes,
    places: Sequence[float] | np.ndarray,
    values: Sequence[float] | np.ndarray,
    interval: tuple[np.ndarray, np.ndarray],
    label: str = "",
) -> None:
    """Draws values as dots with their intervals, the lower and the upper ends."""
    color = palette().vermilion
    axes.vlines(places, *interval, color=color, lw=3, alpha=0.45, gid="interval")
    axes.plot(places, values, "o", color=color, ms=5, label=label)


def logarithmic_values(axes: Axes) -> None:
    """Makes the y axis logarithmic, with plain numbers at its ticks, once its limits are known."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(_log_ticks(*axes.get_ylim()))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _log_ticks(low: float, high: float) -> Locator:
    """Ticks at 1, 2 and 5 times powers of ten, or at round numbers if fewer than two of the former
    lie in the range."""
    powers = LogLocator(subs=(1, 2, 5))
    seen = [tick for tick in powers.tick_values(low, high) if low <= tick <= high]
    return powers if len(seen) > 1 else MaxNLocator(4)


def draw_matrix(
    axes: Axes,
    values: Float[np.ndarray, "rows columns"],
    written: Bool[np.ndarray, "rows columns"],
    text: Callable[[float], str],
    *,
    size: float | int,
    **colors: Any,
) -> AxesImage:
    """Draws a matrix as coloured cells. The caller writes the names of rows and columns.

    **Arguments:**

    - `values`: the numbers; a cell that is NaN stays empty.
    - `written`: the cells whose number is written, as `text` gives it.
    - `size`: the size of the letters. `colors`: the scale of colours, as in `Axes.imshow`.

    **Returns:** the image, for a bar of its colours.
    """
    image = axes.imshow(values, aspect="auto", **colors)
    for row, column in np.argwhere(written):
        value = float(values[row, column])
        red, green, blue, _ = image.to_rgba(np.array(value))
        is_dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.45
        axes.text(
            column, row, text(value), ha="center", va="center", fontsize=points(size),
            color=PALE if is_dark else INK,
        )  # fmt: skip
    without_frame(axes)
    return image
