"""The layers that several pictures draw into their panels. Over time: lines with bands, gaps where
samples are missing, labels at the ends of lines in place of a legend, and the shading of samples of
a lower weight in a match. Of parameters: bars, estimates with their intervals, and matrices.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from itertools import zip_longest
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from ..errors import SimulationError
from ..io import GAP_FACTOR
from ..simulation import Run
from ._panels import color_bar, without_frame, write
from ._style import INK, PALE, color_of, line_of, palette, points, symbol


def draw_lines(
    axes: Axes, time: np.ndarray, columns: np.ndarray, names: Sequence[str] = (), **line: Any
) -> None:
    """Draws a line for each column, in the colours of several lines of one kind; where samples were
    lost the lines have gaps.

    **Arguments:**

    - `names`: the labels of the lines, if they have any.
    - `line`: properties of all lines.
    """
    for number, (series, name) in enumerate(zip_longest(columns.T, names)):
        axes.plot(*joined_samples(time, series), color=color_of(number), label=name, **line)


def draw_duty(axes: Axes, time: np.ndarray, duty: np.ndarray, names: Sequence[str]) -> None:
    """Draws the duty of each cell in steps, dashed such that cells that are driven alike show."""
    for number, (name, part) in enumerate(zip(names, duty.T, strict=True)):
        look = {"color": color_of(number), "ls": line_of(number), "lw": 1.4}
        axes.step(time, 100 * part, where="post", label=name, **look)
    axes.set_ylabel("duty, %")


def draw_band(
    axes: Axes,
    places: np.ndarray,
    band: tuple[np.ndarray, np.ndarray, np.ndarray],
    color: str,
    *,
    alpha: float = 0.2,
    **line: Any,
) -> None:
    """Draws a line, and the band about it in the same colour.

    **Arguments:**

    - `band`: the line, and the lower and upper edge of the band.
    - `alpha`: the opacity of the band.
    - `line`: properties of the line.
    """
    middle, low, high = band
    axes.fill_between(places, low, high, color=color, alpha=alpha, lw=0)
    axes.plot(places, middle, color=color, **line)


def recorded_temperatures(run: Run) -> Float[np.ndarray, "times channels"]:
    """The recorded temperatures of a run.

    **Raises:** `SimulationError` if there are none.
    """
    if run.experiment.temperatures is None:
        label = run.experiment.name or "the experiment"
        raise SimulationError(f"{label}: expected recorded temperatures to compare with, got none")
    return run.experiment.temperatures


def common_start(runs: Sequence[Run]) -> datetime | None:
    """The clock time at 0 s, if all runs have the same one."""
    (first, *others) = {run.experiment.start for run in runs}
    return None if others else first


def shade_masked(axes: Axes, run: Run, weights: Float[np.ndarray, "times channels"]) -> None:
    """Shades the times at which a sample of any channel has a weight below 1; lower weights are
    darker. A missing sample counts as one of weight 1, because it is already a gap in the line.

    **Arguments:**

    - `axes`: axes with the time as x axis, s.
    - `weights`: the weights of the samples, 0 to 1.
    """
    time = run.time
    weight = np.where(run.experiment.sampled, weights, 1.0).min(axis=1)
    edges = np.flatnonzero(np.diff(weight)) + 1
    for part in np.split(np.arange(len(time)), edges):
        if (missing := 1 - float(weight[part[0]])) > 0:
            end = time[min(part[-1] + 1, len(time) - 1)]
            axes.axvspan(
                float(time[part[0]]), float(end), color=palette().faint,
                alpha=0.35 + 0.65 * missing, lw=0, zorder=0.4, gid="masked", label="counted less",
            )  # fmt: skip


def joined_samples(
    time: Float[np.ndarray, " times"], readings: Float[np.ndarray, " times"]
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """The samples that exist, as the points of a line: a sensor that is read less often than the
    recording has rows is a line as well, and where samples were lost the line has a gap."""
    there = ~np.isnan(readings)
    if np.count_nonzero(there) < 2 or np.median(np.diff(np.flatnonzero(there))) <= 1:
        return time, readings  # as often as the rows
    result, values = time[there], readings[there]
    steps = np.diff(result)
    (lost,) = np.nonzero(steps > GAP_FACTOR * np.median(steps))
    return np.insert(result, lost + 1, np.nan), np.insert(values, lost + 1, np.nan)


def label_channels(
    axes: Axes,
    names: Sequence[str],
    values: Float[np.ndarray, "times channels"],
    part: int,
    spacing: float = 0.055,
) -> None:
    """Writes the name of each channel at the end of its line.

    **Arguments:**

    - `part`: a name stands at the mean of the last 1 / `part` of the samples; a channel without
      any sample has none.
    - `spacing`: as in `label_ends`.
    """
    last = max(1, len(values) // part)
    tails = [series[~np.isnan(series)][-last:] for series in values.T]
    ends = [
        (float(tail.mean()), name, color_of(number))
        for number, (tail, name) in enumerate(zip(tails, names, strict=True))
        if tail.size
    ]
    label_ends(axes, ends, spacing=spacing)


def label_ends(
    axes: Axes, ends: Sequence[tuple[float, str, str]], *, spacing: float = 0.055
) -> None:
    """Writes a label to the right of each line's end, moved up or down if two would overlap.

    **Arguments:**

    - `axes`: the axes with the lines, whose y limits are fixed from then on.
    - `ends`: the last value, the label and the colour of each line.
    - `spacing`: the distance between two labels, as a part of the height of the axes.
    """
    if not ends:
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high)
    heights = (np.array([value for value, _, _ in ends]) - low) / (high - low)
    look = {"xycoords": "axes fraction", "va": "center", "annotation_clip": False}
    for (_, label, color), height in zip(ends, space_apart(heights, spacing), strict=True):
        write(axes, label, (1.0, height), (4, 0), color=color, **look)


def space_apart(positions: Float[np.ndarray, " n"], spacing: float) -> Float[np.ndarray, " n"]:
    """Moves positions so that they are at least `spacing` apart, as little as possible.

    This is isotonic regression: the positions minus multiples of the spacing must not decrease, and
    neighbours that do are pooled.
    """
    order = np.argsort(positions, kind="stable")
    wanted = positions[order] - spacing * np.arange(len(positions))
    pools: list[list[float]] = []
    for value in wanted:
        pools.append([value])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            last = pools.pop()
            pools[-1] += last
    level = np.concatenate([np.full(len(pool), np.mean(pool)) for pool in pools])
    moved = np.empty_like(positions)
    moved[order] = level + spacing * np.arange(len(positions))
    return moved


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


def draw_correlations(ax: Axes, correlation: np.ndarray, written: np.ndarray) -> None:
    """Draws correlations, -1 to 1, as a matrix with a bar of its colours; see `draw_matrix`."""
    image = draw_matrix(
        ax, correlation, written, lambda value: f"{value:.2f}".replace("0.", "."), size=7.5,
        cmap="RdBu_r", vmin=-1, vmax=1,
    )  # fmt: skip
    bar = color_bar(ax, image, fraction=0.03, pad=0.01, ticks=[-1, 0, 1])
    bar.ax.tick_params(length=0, colors=palette().muted)
