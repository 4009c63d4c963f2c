"""The layers of pictures of recordings: lines with bands, gaps where samples are missing, labels at
the ends of lines in place of a legend, and the shading of samples of a lower weight in a match.
"""

from collections.abc import Sequence
from datetime import datetime
from itertools import zip_longest
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ..errors import SimulationError
from ..io._gaps import GAP_FACTOR
from ..simulation import Run
from ._panels import write
from ._style import color_of, palette


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
