"""Recordings, Fig. 6 of the paper, and the twin beside them: its temperatures (Fig. 15), the band
in which readings are expected, and the uniformity of its channels.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._statistics import fit_text, mean_fit_percent
from ..errors import SimulationError
from ..io import Experiment
from ..observers import Forecast
from ..simulation import Run
from ._layers import (
    common_start,
    draw_lines,
    joined_samples,
    label_channels,
    label_ends,
    recorded_temperatures,
)
from ._panels import legend_of_all, panels, panels_in_rows, time_axis, title_aside, write
from ._style import Dashes, color_of, line_of, palette, styled

# The largest number of channels in a row.
MAX_PANELS = 5

# The smallest width of a comparison, whose heading and legend stand beside each other, inches.
MIN_WIDTH = 6.4


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
    figure, grid = panels(
        len(heights), columns, 0.9 + 3.7 * columns, 5.0 if has_temperatures else 1.9,
        sharex="col", sharey="row", height_ratios=heights,
    )  # fmt: skip
    for axes, experiment in zip(grid.T, experiments, strict=True):
        kind = "schedule" if experiment.temperatures is None else "recording"
        axes[0].set_title(experiment.name or kind)
        if experiment.temperatures is not None:
            draw_lines(axes[0], experiment.time, experiment.temperatures, lw=1.1)
        for cells, color, dashes in _drives(experiment):
            duty = 100 * experiment.duty[:, cells[0]]
            axes[-1].step(experiment.time, duty, where="post", lw=1.4, color=color, ls=dashes)
        time_axis(axes[-1], experiment.time, experiment.start)
    if has_temperatures:
        grid[0, 0].set_ylabel("temperature, °C")
    grid[-1, 0].set_ylabel("duty, %")
    _fit_duty(grid[-1, 0], experiments)
    for axes, experiment in zip(grid.T, experiments, strict=True):
        ends = [
            (
                100 * float(experiment.duty[-1, cells[0]]),
                ", ".join(experiment.cell_names[cell] for cell in cells),
                color,
            )
            for cells, color, _ in _drives(experiment)
        ]
        label_ends(axes[-1], ends, spacing=0.2)
        if experiment.temperatures is not None:
            label_channels(axes[0], experiment.channels, experiment.temperatures, part=50)
    return figure


def _drives(experiment: Experiment) -> list[tuple[list[int], str, str | Dashes]]:
    """The cells of each different drive, with its colour and its dashes."""
    drives: dict[bytes, list[int]] = {}
    for cell, duty in enumerate(experiment.duty.T):
        drives.setdefault(duty.tobytes(), []).append(cell)
    return [(cells, color_of(n), line_of(n)) for n, cells in enumerate(drives.values())]


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
    width, height = max(1.0 + 2.35 * columns, MIN_WIDTH), 0.8 + 1.95 * len(rows)
    figure, grid = panels(len(rows), columns, width, height, sharex=True, sharey=True)
    recorded = {"color": palette().muted, "alpha": 0.4, "solid_joinstyle": "round"}
    twin = {"color": palette().vermilion, "lw": TWIN, "label": "twin, with its fit"}
    for row, (run, fit, channels) in zip(grid, rows, strict=True):
        for axes, channel in zip(row, channels, strict=False):
            readings = recorded_temperatures(run)[:, run.channels.index(channel)]
            points = joined_samples(run.time, readings)
            axes.plot(*points, **recorded, lw=RECORDED, label="recorded")
            axes.plot(run.time, run.channel(channel), **twin)
            axes.set_title(channel)
            text = fit_text(fit[channel], " %") if channel in fit else "no sample"
            axes.set_title(text, loc="right", color=palette().vermilion)
        for axes in row[len(channels) :]:
            axes.set_axis_off()
        row[0].set_ylabel("temperature, °C")
        write(row[0], run.experiment.name, (0, 1), (0, 18), xycoords="axes fraction")
    for axes in grid[-1]:
        time_axis(axes, np.concatenate([run.time for run in runs]), common_start(runs))
    legend_of_all(figure, "outside upper right")
    mean = mean_fit_percent(value for fit in fits for value in fit.values())
    figure.suptitle(f"{runs[0].rig}: mean fit {mean:.1f} %", x=0.01, ha="left")
    return figure


@styled
def plot_bands(
    run: Run,
    low: Float[np.ndarray, "times channels"],
    high: Float[np.ndarray, "times channels"],
    *,
    level: float = 0.95,
) -> Figure:
    """Plots a run with the band in which a reading is expected, a panel for each channel.

    The number in a panel is the part of the recorded samples that lies inside.

    **Arguments:**

    - `run`: the prediction of the twin; recorded temperatures are drawn if there are any.
    - `low`, `high`: the edges of the band, degC.
    - `level`: the share of readings that are expected in the band, for the legend.

    **Returns:** the figure.

    **Raises:** `SimulationError` if the band has another shape than the run.
    """
    for name, edge in (("low", low), ("high", high)):
        if np.shape(edge) != run.temperatures.shape:
            raise SimulationError(
                f"{name}: expected shape {run.temperatures.shape}, got {np.shape(edge)}"
            )
    band = (run.temperatures, low, high)
    recorded = run.experiment.temperatures
    return _draw_bands(run.time, run.channels, band, recorded, f"{100 * level:g} % band", "twin")


@styled
def plot_forecast(forecast: Forecast) -> Figure:
    """Plots expected readings with their 95 % bands, a panel for each channel.

    The number in a panel is the part of the recorded samples that lies inside.

    **Arguments:**

    - `forecast`: the result of `Observed.ahead`, `Observed.forecast` or `Observed.expected`.

    **Returns:** the figure.
    """
    is_ahead = math.isfinite(forecast.lead)
    label = f"expected {forecast.lead:g} s before" if is_ahead else "expected"
    return _draw_bands(
        forecast.time, forecast.channels, (forecast.mean, forecast.lower, forecast.upper),
        forecast.recorded, "95 % band", label,
    )  # fmt: skip


def _draw_bands(
    time: Float[np.ndarray, " times"],
    channels: Sequence[str],
    band: tuple[np.ndarray, np.ndarray, np.ndarray],
    recorded: Float[np.ndarray, "times channels"] | None,
    *labels: str,
) -> Figure:
    """Draws a panel for each channel.

    **Arguments:**

    - `band`: the middle, the lower and the upper edge of the band, each `(times, channels)`.
    - `labels`: those of the band and of its middle.
    """
    size = (2.5 if len(channels) > 1 else 5.0, 2.3)
    figure, grid = panels_in_rows(len(channels), MAX_PANELS, size, (1.0, 0.8), sharey=True)
    for number, (axes, channel) in enumerate(zip(grid, channels, strict=True)):
        middle, low, high = (edge[:, number] for edge in band)
        axes.fill_between(time, low, high, color=palette().sky, alpha=0.45, lw=0, label=labels[0])
        if recorded is not None:
            readings = recorded[:, number]
            points = joined_samples(time, readings)
            axes.plot(*points, color=palette().muted, lw=1.0, label="recorded")
            there = ~np.isnan(readings)
            inside = np.count_nonzero((low <= readings) & (readings <= high)) / max(1, there.sum())
            title_aside(axes, f"{100 * inside:.0f} % inside" if there.any() else "no sample")
        axes.plot(time, middle, color=palette().vermilion, lw=1.2, label=labels[1])
        axes.set_title(channel)
    for axes in grid[-MAX_PANELS:]:
        time_axis(axes, time)
    for axes in grid[::MAX_PANELS]:
        axes.set_ylabel("temperature, °C")
    legend_of_all(figure)
    return figure


@styled
def plot_uniformity(runs: Sequence[Run]) -> Figure:
    """Plots range (highest minus lowest) and standard deviation over the channels at each time.

    A time at which a channel's sample is missing is a gap in the recorded line.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures, one column each.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with.
    """
    size = (0.9 + 3.7 * len(runs), 4.4)
    figure, grid = panels(2, len(runs), *size, sharex="col", sharey="row")
    was = {"color": palette().muted, "lw": 2.4, "alpha": 0.55, "label": "recorded channels"}
    says = {"color": palette().vermilion, "lw": 1.4, "label": "the twin's channels"}
    for (above, below), run in zip(grid.T, runs, strict=True):
        recorded, twin = run.recorded_uniformity, run.uniformity
        above.plot(run.time, recorded.range, **was)
        above.plot(run.time, twin.range, **says)
        title_aside(above, f"mean {recorded.mean_range:.2f} K, twin {twin.mean_range:.2f} K")
        below.plot(run.time, recorded.std, **was)
        below.plot(run.time, twin.std, **says)
        title_aside(below, f"mean {recorded.mean_std:.2f} K, twin {twin.mean_std:.2f} K")
        above.set_title(run.experiment.name or "recording")
        time_axis(below, run.time, run.experiment.start)
    for axes in grid[:, 0]:
        axes.set_ylim(bottom=0)  # fixes the limits of the whole row
    grid[0, 0].set_ylabel("highest − lowest, K")
    grid[1, 0].set_ylabel("standard deviation, K")
    legend_of_all(figure)
    return figure
