"""Recorded responses and the drive behind them, Fig. 6 of the paper."""

from collections.abc import Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..io import Experiment
from ._labels import label_ends
from ._samples import joined_samples, means_of_last_samples
from ._style import Dashes, line_of, palette, styled


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
                    color=palette().cycle[number % len(palette().cycle)],
                    lw=1.1,
                )
        for cells, color, dashes in _drives(experiment):
            duty = 100 * experiment.duty[:, cells[0]]
            axes[-1].step(experiment.time, duty, where="post", lw=1.4, color=color, ls=dashes)
        axes[-1].set_xlabel("time, s")
        axes[-1].set_xlim(experiment.time[0], experiment.time[-1])
    if has_temperatures:
        grid[0, 0].set_ylabel("temperature, °C")
    grid[-1, 0].set_ylabel("duty, %")
    _fit_duty(grid[-1, 0], experiments)
    for axes, experiment in zip(grid.T, experiments, strict=True):
        label_ends(axes[-1], _cells_by_drive(experiment), spacing=0.2)
        if experiment.temperatures is not None:
            tail = means_of_last_samples(experiment.temperatures, len(experiment.time) // 50)
            colors = [palette().cycle[number % len(palette().cycle)] for number in range(len(tail))]
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
