"""Simulated beside recorded temperatures, Fig. 15 of the paper, and what is left over: the
difference, whether it is noise, and the error that all channels share.
"""

from collections.abc import Sequence
from datetime import datetime
from itertools import zip_longest
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .._statistics import (
    QUANTILE_975,
    autocorrelation,
    fit_text,
    ljung_box,
    mean_fit_percent,
    normal_quantiles,
)
from ..errors import SimulationError
from ..matching import Fit
from ..simulation import Run
from ._panels import title_aside
from ._recordings import (
    joined_samples,
    label_ends,
    masked_key,
    mean_of_samples,
    means_of_last_samples,
    shade_masked,
    weights_of_samples,
)
from ._style import color_of, palette, points, styled
from ._time_axis import time_axis

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
        time_axis(axes, np.concatenate([run.time for run in runs]), _start(runs))
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
            axes.plot(run.time, part, color=color_of(number), lw=0.9)
        axes.plot(run.time, mean_of_samples(residual, axis=1), color=palette().ink, lw=2.0)
        axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0)
        axes.set_title(run.experiment.name or "recording")
        time_axis(axes, run.time, _start(runs))
        title_aside(axes, f"RMSE {run.rmse:.2f} K")
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


def _start(runs: Sequence[Run]) -> datetime | None:
    """The clock time at 0 s, if all runs have the same one."""
    (first, *others) = {run.experiment.start for run in runs}
    return None if others else first


def _as_recorded() -> dict[str, Any]:
    return {"color": palette().muted, "lw": RECORDED, "alpha": 0.4, "solid_joinstyle": "round"}


def _recorded(run: Run) -> Float[np.ndarray, "times channels"]:
    if run.experiment.temperatures is None:
        label = run.experiment.name or "the experiment"
        raise SimulationError(f"{label}: expected recorded temperatures to compare with, got none")
    return run.experiment.temperatures


# The largest lag of the autocorrelation that is shown, samples.
MAX_LAG = 300

# The smallest number of samples of a channel for a test of whiteness.
MIN_SAMPLES = 10


@styled
def plot_residual_tests(runs: Sequence[Run]) -> Figure:
    """Plots the residuals of each recording over time, their autocorrelation, and their quantiles.

    Missing samples are gaps over time and left out of the tests.

    In the middle panel the grey band contains 95 % of the autocorrelations of white noise. In the
    right panel normal residuals lie on the line. The p-value is that of Ljung and Box's test, the
    smallest of all channels.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures, one row each; those of a
      validation are `list(validation.runs.values())`.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with, or fewer than
    ten samples in a channel.
    """
    figure = pyplot.figure(figsize=(12.6, 0.4 + 2.6 * len(runs)), layout="constrained")
    grid = figure.subplots(len(runs), 3, squeeze=False, width_ratios=(1.7, 1.15, 1))
    for row, run in zip(grid, runs, strict=True):
        if run.experiment.temperatures is None:
            label = run.experiment.name or "the experiment"
            raise SimulationError(
                f"{label}: expected recorded temperatures to compare with, got none"
            )
        counts = np.count_nonzero(run.experiment.sampled, axis=0)
        if counts.min() < MIN_SAMPLES:
            label = run.experiment.name or "the experiment"
            raise SimulationError(
                f"{label}: channel {run.channels[int(counts.argmin())]}: expected at least "
                f"{MIN_SAMPLES} samples for a test, got {counts.min()}"
            )
        residuals = run.experiment.temperatures - run.temperatures
        for number, (channel, series) in enumerate(zip(run.channels, residuals.T, strict=True)):
            _draw(row, run, channel, series, color_of(number))
        _finish(row, run, residuals)
    grid[0, 1].legend(loc="lower right")
    for axes, text in zip(grid[-1, 1:], ("lag, s", "normal quantile"), strict=True):
        axes.set_xlabel(text)
    time_axis(grid[-1, 0], np.concatenate([run.time for run in runs]), _start(runs))
    return figure


def _draw(row: np.ndarray, run: Run, channel: str, series: np.ndarray, color: str) -> None:
    over_time, against_itself, against_normal = row
    over_time.plot(run.time, series, color=color, lw=0.9)
    sample = float(np.median(np.diff(run.time)))
    lags = min(MAX_LAG, len(series) // 2)
    against_itself.plot(
        sample * np.arange(lags + 1), autocorrelation(series, lags), color=color, lw=1.2
    )
    there = series[~np.isnan(series)]
    standard_deviation = there.std() or 1.0
    against_normal.plot(
        normal_quantiles(len(there)), np.sort(there - there.mean()) / standard_deviation,
        color=color, lw=1.4, label=channel,
    )  # fmt: skip


def _finish(row: np.ndarray, run: Run, residuals: np.ndarray) -> None:
    over_time, against_itself, against_normal = row
    over_time.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
    over_time.set(ylabel="recorded − twin, K", xlim=(run.time[0], run.time[-1]))
    over_time.set_title(run.experiment.name or "recording")
    title_aside(over_time, f"RMSE {run.rmse:.2f} K")
    tail = means_of_last_samples(residuals, len(run.time) // 20)
    label_ends(
        over_time, list(zip(tail.tolist(), run.channels, palette().cycle * len(tail), strict=False))
    )
    band = QUANTILE_975 / np.sqrt(np.count_nonzero(run.experiment.sampled, axis=0).max())
    against_itself.axhspan(
        -band, band, color=palette().faint, zorder=0.4, label="95 % of white noise"
    )
    against_itself.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
    against_itself.set(ylabel="autocorrelation", ylim=(-1.05, 1.05))
    p = min(ljung_box(series).p_value for series in residuals.T)
    text = f"p = {p:.2g}" if p > 1e-99 else "p below 1e-99"
    title_aside(against_itself, text)
    line = np.array([-3.3, 3.3])
    against_normal.plot(line, line, color=palette().ink, lw=0.8, ls=(0, (4, 3)), zorder=0.6)
    against_normal.set(ylabel="standardised residual")


@styled
def plot_camera_error(fit: Fit) -> Figure:
    """Plots the mean residual of each recording's channels with and without the camera's error.

    The upper panel shows the mean of recorded minus simulated temperatures, and in colour the error
    that the match attributes to the camera; ticks mark its flat-field corrections. The lower panel
    shows the difference of the two, which remains for the plate. Shaded spans had a lower weight in
    the match.

    **Arguments:**

    - `fit`: the result of `jaxtwin.match`.

    **Returns:** the figure.
    """
    columns = len(fit.runs)
    weights = {name: weights_of_samples(run, fit.weights[name]) for name, run in fit.runs.items()}
    figure = pyplot.figure(figsize=(0.9 + 3.9 * columns, 4.6), layout="constrained")
    grid = figure.subplots(2, columns, sharex="col", sharey=True, squeeze=False)
    for (above, below), (name, run) in zip(grid.T, fit.runs.items(), strict=True):
        assert run.experiment.temperatures is not None
        camera = fit.camera[name]
        shared = mean_of_samples(run.experiment.temperatures - run.temperatures, axis=1)
        above.plot(run.time, shared, color=palette().muted, lw=1.0)
        above.plot(run.time, camera.offset, color=palette().vermilion, lw=1.6)
        below.plot(run.time, shared - camera.offset, color=palette().ink, lw=1.0)
        for axes, series, title in ((above, shared, name), (below, shared - camera.offset, "")):
            shade_masked(axes, run.time, weights[name])
            axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
            rms = float(np.sqrt(np.nanmean(series**2)))
            axes.set_title(title)
            title_aside(axes, f"{rms:.2f} K rms")
        if camera.events:
            # The ticks are at the upper edge: lines through the whole panel would hide the jumps.
            edge = above.get_xaxis_transform()
            above.plot(
                camera.events, np.full(len(camera.events), 0.97), "v", color=palette().orange, ms=5,
                transform=edge, clip_on=False,
            )  # fmt: skip
        below.set_xlim(run.time[0], run.time[-1])
        time_axis(below, run.time, run.experiment.start)
    grid[0, 0].set_ylabel("recorded − twin, K")
    grid[1, 0].set_ylabel("without camera, K")
    corrections = Line2D([], [], color=palette().orange, marker="v", ls="", label="its corrections")
    figure.legend(
        handles=[
            Line2D([], [], color=palette().muted, lw=1.2, label="mean of the channels"),
            Line2D([], [], color=palette().vermilion, lw=1.6, label="given to the camera"),
            *([corrections] if any(camera.events for camera in fit.camera.values()) else []),
            Line2D([], [], color=palette().ink, lw=1.2, label="left for the plate"),
            *masked_key(weights.values()),
        ],
        loc="outside lower center",
        ncols=5,
    )
    return figure
