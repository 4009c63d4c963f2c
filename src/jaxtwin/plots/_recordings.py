"""Recorded responses and the drive behind them, Fig. 6 of the paper.

Also what all pictures of recordings share: labels at the ends of lines in place of a legend, and
the marks of samples that are missing or have a lower weight in a match.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..io import GAP_FACTOR, Experiment
from ..simulation import Run
from ._style import Dashes, color_of, line_of, palette, points, styled
from ._time_axis import time_axis


@styled
def plot_recordings(experiments: Sequence[Experiment]) -> Figure:
    """Plots the channels' temperatures above the cells' duty cycles.

    Missing samples are gaps in the lines.

    **Arguments:**

    - `experiments`: the experiments, one column each. Those without recorded temperatures have only
      their duty cycles; if none has any, so does the figure.

    **Returns:** the figure.
    """
    columns = len(experiments)
    has_temperatures = any(experiment.temperatures is not None for experiment in experiments)
    heights = (4, 1) if has_temperatures else (1,)
    size = (0.9 + 3.7 * columns, 5.0 if has_temperatures else 1.9)
    figure = pyplot.figure(figsize=size, layout="constrained")
    grid = figure.subplots(
        len(heights), columns, sharex="col", sharey="row", height_ratios=heights, squeeze=False
    )
    for axes, experiment in zip(grid.T, experiments, strict=True):
        kind = "schedule" if experiment.temperatures is None else "recording"
        axes[0].set_title(experiment.name or kind)
        if experiment.temperatures is not None:
            for number, temperature in enumerate(experiment.temperatures.T):
                axes[0].plot(
                    *joined_samples(experiment.time, temperature),
                    color=color_of(number),
                    lw=1.1,
                )
        for cells, color, dashes in _drives(experiment):
            duty = 100 * experiment.duty[:, cells[0]]
            axes[-1].step(experiment.time, duty, where="post", lw=1.4, color=color, ls=dashes)
        axes[-1].set_xlim(experiment.time[0], experiment.time[-1])
        time_axis(axes[-1], experiment.time, experiment.start)
    if has_temperatures:
        grid[0, 0].set_ylabel("temperature, °C")
    grid[-1, 0].set_ylabel("duty, %")
    _fit_duty(grid[-1, 0], experiments)
    for axes, experiment in zip(grid.T, experiments, strict=True):
        label_ends(axes[-1], _cells_by_drive(experiment), spacing=0.2)
        if experiment.temperatures is not None:
            tail = means_of_last_samples(experiment.temperatures, len(experiment.time) // 50)
            colors = [color_of(number) for number in range(len(tail))]
            label_ends(axes[0], list(zip(tail.tolist(), experiment.channels, colors, strict=True)))
    return figure


def _cells_by_drive(experiment: Experiment) -> list[tuple[float, str, str]]:
    """The label of each different drive: the cells that it drives."""
    return [
        (
            100 * float(experiment.duty[-1, cells[0]]),
            ", ".join(experiment.cell_names[cell] for cell in cells),
            color,
        )
        for cells, color, _ in _drives(experiment)
    ]


def _drives(experiment: Experiment) -> list[tuple[list[int], str, str | Dashes]]:
    """The cells of each different drive, with its colour and its dashes."""
    drives: dict[bytes, list[int]] = {}
    for cell, duty in enumerate(experiment.duty.T):
        drives.setdefault(duty.tobytes(), []).append(cell)
    cycle = palette().cycle
    return [
        (cells, cycle[number % len(cycle)], line_of(number))
        for number, cells in enumerate(drives.values())
    ]


def _fit_duty(axes: Axes, experiments: Sequence[Experiment]) -> None:
    """Fits the axis to all duty cycles and 0, rounded to the ticks."""
    lowest = min(float(np.min(experiment.duty)) for experiment in experiments)
    highest = max(float(np.max(experiment.duty)) for experiment in experiments)
    low, high = 100 * min(0.0, lowest), 100 * max(0.0, highest)
    if low == high:
        high = 100.0
    ticks = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high)
    # The locator may add a tick beyond the data at an end.
    step = ticks[1] - ticks[0]
    first, last = np.floor(low / step + 1e-9) * step, np.ceil(high / step - 1e-9) * step
    room = 0.04 * (last - first)
    axes.set_ylim(first - room, last + room)
    axes.set_yticks(np.arange(first, last + step / 2, step))


def weights_of_samples(
    run: Run, weights: Float[np.ndarray, "times channels"]
) -> Float[np.ndarray, "times channels"]:
    """Returns the weights of a run's samples. A missing sample gets the weight 1, because it is
    already a gap in the line."""
    return np.where(run.experiment.sampled, weights, 1.0)


def shade_masked(
    axes: Axes, time: Float[np.ndarray, " times"], weights: Float[np.ndarray, "times channels"]
) -> None:
    """Shades the times at which a sample of any channel has a weight below 1; lower weights are
    darker.

    **Arguments:**

    - `axes`: axes with the time as x axis, s.
    - `weights`: the weights of the samples, 0 to 1.
    """
    weight = weights.min(axis=1)
    edges = np.flatnonzero(np.diff(weight)) + 1
    for part in np.split(np.arange(len(time)), edges):
        if (missing := 1 - float(weight[part[0]])) > 0:
            end = time[min(part[-1] + 1, len(time) - 1)]
            axes.axvspan(
                float(time[part[0]]), float(end), color=palette().faint,
                alpha=0.35 + 0.65 * missing, lw=0,
                zorder=0.4, gid="masked",
            )  # fmt: skip


def masked_key(weights: Iterable[Float[np.ndarray, "_ _"]]) -> list[Patch]:
    """Returns the legend entry of the shading; empty if nothing is shaded."""
    shaded = any(bool((weight < 1).any()) for weight in weights)
    return [Patch(color=palette().faint, lw=0, label="counted less")] if shaded else []


def mean_of_samples(
    values: Float[np.ndarray, "rows columns"], axis: int
) -> Float[np.ndarray, " kept"]:
    """Computes the mean along an axis over the samples that exist; NaN if there are none.

    **Arguments:**

    - `values`: the samples; NaN for a missing one.
    """
    there = ~np.isnan(values)
    counts = there.sum(axis=axis)
    sums = np.sum(values, axis=axis, where=there)
    return np.divide(sums, counts, out=np.full(counts.shape, np.nan), where=counts > 0)


def means_of_last_samples(
    values: Float[np.ndarray, "times channels"], samples: int
) -> Float[np.ndarray, " channels"]:
    """Computes the mean of the last existing samples of each channel; NaN if it has none.

    **Arguments:**

    - `samples`: the number of samples; at least one is used.
    """
    ends = [column[~np.isnan(column)][-max(1, samples) :] for column in values.T]
    return np.array([end.mean() if end.size else np.nan for end in ends])


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


def label_ends(
    axes: Axes, ends: Sequence[tuple[float, str, str]], *, spacing: float = 0.055
) -> None:
    """Writes a label to the right of each line's end, moved up or down if two would overlap.

    **Arguments:**

    - `axes`: the axes with the lines, whose y limits are fixed from then on.
    - `ends`: the last value, the label and the colour of each line; a line without a value (NaN)
      has no label.
    - `spacing`: the distance between two labels, as a part of the height of the axes.
    """
    ends = [end for end in ends if not np.isnan(end[0])]
    if not ends:
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high)
    heights = (np.array([value for value, _, _ in ends]) - low) / (high - low)
    for (_, label, color), height in zip(ends, space_apart(heights, spacing), strict=True):
        axes.annotate(
            label,
            (1.0, height),
            xycoords="axes fraction",
            xytext=(4, 0),
            textcoords="offset points",
            color=color,
            fontsize=points(9),
            va="center",
            annotation_clip=False,
        )


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
