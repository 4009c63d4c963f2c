"""The predictions of a twin, with their uncertainty."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..errors import SimulationError
from ..observers import Forecast
from ..simulation import Run
from ._panels import title_aside
from ._recordings import joined_samples
from ._style import palette, styled
from ._time_axis import time_axis

MAX_PANELS = 5  # panels in a row


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
    return draw_bands(
        run.time,
        run.channels,
        run.temperatures,
        low,
        high,
        run.experiment.temperatures,
        level=level,
        label="twin",
    )


@styled
def plot_forecast(forecast: Forecast) -> Figure:
    """Plots expected readings with their 95 % bands, a panel for each channel.

    The number in a panel is the part of the recorded samples that lies inside.

    **Arguments:**

    - `forecast`: the result of `Observed.ahead`, `Observed.forecast` or `Observed.expected`.

    **Returns:** the figure.
    """
    ahead = math.isfinite(forecast.lead)
    return draw_bands(
        forecast.time,
        forecast.channels,
        forecast.mean,
        forecast.lower,
        forecast.upper,
        forecast.recorded,
        level=0.95,
        label=f"expected {forecast.lead:g} s before" if ahead else "expected",
    )


def draw_bands(
    time: Float[np.ndarray, " times"],
    channels: Sequence[str],
    middle: Float[np.ndarray, "times channels"],
    low: Float[np.ndarray, "times channels"],
    high: Float[np.ndarray, "times channels"],
    recorded: Float[np.ndarray, "times channels"] | None,
    *,
    level: float,
    label: str,
) -> Figure:
    """Draws a panel for each channel."""
    count = len(channels)
    columns = min(count, MAX_PANELS)
    rows = -(-count // columns)
    size = (1.0 + 2.5 * max(columns, 2), 0.8 + 2.3 * rows)
    figure = pyplot.figure(figsize=size, layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for number, (axes, channel) in enumerate(zip(grid.flat, channels, strict=False)):
        below, above = low[:, number], high[:, number]
        axes.fill_between(time, below, above, color=palette().sky, alpha=0.45, lw=0)
        if recorded is not None:
            readings = recorded[:, number]
            axes.plot(*joined_samples(time, readings), color=palette().muted, lw=1.0)
            there = ~np.isnan(readings)
            inside = np.count_nonzero((below <= readings) & (readings <= above)) / max(
                1, there.sum()
            )
            share = f"{100 * inside:.0f} % inside" if there.any() else "no sample"
            title_aside(axes, share)
        axes.plot(time, middle[:, number], color=palette().vermilion, lw=1.2)
        axes.set_title(channel)
    for axes in list(grid.flat)[count:]:
        axes.set_axis_off()
    for axes in grid[-1]:
        time_axis(axes, time)
    for axes in grid[:, 0]:
        axes.set_ylabel("temperature, °C")
    grid[0, 0].set_xlim(time[0], time[-1])
    marks = [
        Patch(color=palette().sky, alpha=0.45, lw=0, label=f"{100 * level:g} % band"),
        Line2D([], [], color=palette().vermilion, lw=1.2, label=label),
    ]
    if recorded is not None:
        marks.append(Line2D([], [], color=palette().muted, lw=1.0, label="recorded"))
    figure.legend(handles=marks, loc="outside lower center", ncols=3)
    return figure
