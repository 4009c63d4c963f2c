"""Recorded responses and the drive behind them, Fig. 6 of the paper."""

from collections.abc import Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..io import Experiment
from ._labels import label_ends
from ._samples import means_of_last_samples
from ._style import palette, styled


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
                    experiment.time,
                    temperature,
                    color=palette().cycle[number % len(palette().cycle)],
                    lw=1.1,
                )
        for duty in np.unique(experiment.duty, axis=1).T:
            axes[-1].step(experiment.time, 100 * duty, where="post", lw=1.3, color=palette().ink)
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
    drives: dict[bytes, list[int]] = {}
    for cell, duty in enumerate(experiment.duty.T):
        drives.setdefault(duty.tobytes(), []).append(cell)
    return [
        (
            100 * float(experiment.duty[-1, cells[0]]),
            ", ".join(f"P{cell + 1}" for cell in cells),
            palette().ink,
        )
        for cells in drives.values()
    ]


def _fit_duty(axes: Axes, experiments: Sequence[Experiment]) -> None:
    lowest = min(float(np.min(experiment.duty)) for experiment in experiments)
    axes.set_ylim(-105 if lowest < 0 else -4, 105)
    axes.set_yticks([-100, 0, 100] if lowest < 0 else [0, 50, 100])
