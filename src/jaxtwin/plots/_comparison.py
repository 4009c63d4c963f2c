"""Simulated beside recorded temperatures, Fig. 15 of the paper, and their difference."""

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from .._goodness_of_fit import fit_text, mean_fit_percent
from ..errors import SimulationError
from ..simulation import Run
from ._labels import label_ends
from ._samples import (
    joined_samples,
    masked_key,
    mean_of_samples,
    means_of_last_samples,
    shade_masked,
    weights_of_samples,
)
from ._style import palette, points, styled

MAX_PANELS = 5  # panels in a row
MIN_WIDTH_INCHES = 6.4  # inches, which the heading and the legend need beside each other

RECORDED, TWIN = 5.0, 1.0
"""The widths of the lines, points. The twin's is thin, so that the recording shows on both sides of
it where they agree."""


@styled
def plot_comparison(runs: Sequence[Run]) -> Figure:
    """Plots simulated and recorded temperatures, a panel for each channel with its NRMSE fit.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures; the runs of a match are
      `list(fit.runs.values())`.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with.
    """
    fits = [run.fit_percent for run in runs]
    rows = [
        (run, fit, run.channels[start : start + MAX_PANELS])
        for run, fit in zip(runs, fits, strict=True)
        for start in range(0, len(run.channels), MAX_PANELS)
    ]
    columns = max(len(channels) for _, _, channels in rows)
    size = (max(1.0 + 2.35 * columns, MIN_WIDTH_INCHES), 0.8 + 1.95 * len(rows))
    figure = pyplot.figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rows), columns, sharex=True, sharey=True, squeeze=False)
    for panels, (run, fit, channels) in zip(grid, rows, strict=True):
        for axes, channel in zip(panels, channels, strict=False):
            recorded = _recorded(run)[:, run.channels.index(channel)]
            axes.plot(*joined_samples(run.time, recorded), **_as_recorded())
            axes.plot(run.time, run.channel(channel), color=palette().vermilion, lw=TWIN)
            axes.set_title(channel)
            text = fit_text(fit[channel], " %") if channel in fit else "no sample"
            axes.set_title(text, loc="right", color=palette().vermilion)
        for axes in panels[len(channels) :]:
            axes.set_axis_off()
        panels[0].set_ylabel("temperature, °C")
        panels[0].annotate(
            run.experiment.name, (0, 1), xycoords="axes fraction", xytext=(0, 18),
            textcoords="offset points", color=palette().muted, fontsize=points(9),
        )  # fmt: skip
    for axes in grid[-1]:
        axes.set_xlabel("time, s")
        axes.xaxis.set_major_locator(MaxNLocator(2))
    grid[0, 0].set_xlim(min(run.time[0] for run in runs), max(run.time[-1] for run in runs))
    mean = mean_fit_percent(value for fit in fits for value in fit.values())
    figure.legend(
        handles=[
            Line2D([], [], **_as_recorded(), label="recorded"),
            Line2D([], [], color=palette().vermilion, lw=TWIN, label="twin, with its fit"),
        ],
        loc="outside upper right",
        ncols=2,
    )
    figure.suptitle(f"{runs[0].rig}: mean fit {mean:.1f} %", x=0.01, ha="left")
    return figure


@styled
def plot_residuals(
    runs: Sequence[Run], *, weights: Sequence[Float[np.ndarray, "_ _"]] = ()
) -> Figure:
    """Plots recorded minus simulated temperature of every channel, and their mean.

    An error that all channels share comes from the camera or the ambient; an error of a single
    channel comes from its place on the plate. Missing samples are gaps.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures, one column each.
    - `weights`: the weights of each run's samples in a match, `(times, channels)`, 0 to 1, such as
      `list(fit.weights.values())`: spans with a lower weight are shaded.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with.
    """
    figure = pyplot.figure(figsize=(0.9 + 3.7 * len(runs), 3.4), layout="constrained")
    (row,) = figure.subplots(1, len(runs), sharey=True, squeeze=False)
    ends = []
    for axes, run, weight in zip_longest(row, runs, weights):
        if weight is not None:
            shade_masked(axes, run.time, weights_of_samples(run, weight))
        residual = _recorded(run) - run.temperatures
        for number, part in enumerate(residual.T):
            axes.plot(run.time, part, color=palette().cycle[number % len(palette().cycle)], lw=0.9)
        axes.plot(run.time, mean_of_samples(residual, axis=1), color=palette().ink, lw=2.0)
        axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0)
        axes.set(title=run.experiment.name or "recording", xlabel="time, s")
        axes.set_title(
            f"RMSE {run.rmse:.2f} K", loc="right", fontsize=points(9), fontweight="normal"
        )
        axes.set_xlim(run.time[0], run.time[-1])
        tail = means_of_last_samples(residual, len(run.time) // 20)
        ends.append(
            list(zip(tail.tolist(), run.channels, palette().cycle * len(tail), strict=False))
        )
    row[0].set_ylabel("recorded − twin, K")
    for axes, labels in zip(row, ends, strict=True):
        label_ends(axes, labels, spacing=0.08)
    figure.legend(
        handles=[
            Line2D([], [], color=palette().ink, lw=2.0, label="mean of the channels"),
            *masked_key(weights_of_samples(*pair) for pair in zip(runs, weights, strict=False)),
        ],
        loc="outside lower right",
        ncols=2,
    )
    return figure


def _as_recorded() -> dict[str, Any]:
    return {"color": palette().muted, "lw": RECORDED, "alpha": 0.4, "solid_joinstyle": "round"}


def _recorded(run: Run) -> Float[np.ndarray, "times channels"]:
    if run.experiment.temperatures is None:
        label = run.experiment.name or "the experiment"
        raise SimulationError(f"{label}: expected recorded temperatures to compare with, got none")
    return run.experiment.temperatures
