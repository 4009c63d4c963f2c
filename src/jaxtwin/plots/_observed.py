"""A recording that an observer followed: its estimates over time, and tests of its innovations."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._number_text import short_number
from ..observers import Estimate, Observed
from ._panels import legend_beside, title_aside
from ._series import joined_samples
from ._style import color_of, palette, styled
from ._time_axis import time_axis

# The largest lag of the autocorrelations, samples.
LAGS = 40

# The smallest number of samples for a test.
MIN_SAMPLES = 50

# The times ahead at which forecasts are judged, samples.
LEADS = (1, 2, 5, 10, 20, 50, 100, 200, 500)

# The largest number of channels or nodes with a line of their own.
MAX_CHANNELS = 8


@styled
def plot_observed(observed: Observed) -> Figure:
    """Plots what was read, and what the observer says of the rig, with 95 % bands.

    The panels are the readings, the nodes that no channel sees directly (estimates, not
    measurements), the heats that the twin does not explain, and the room. Heats that are within
    their bands all the time have no panel, but a note.

    **Arguments:**

    - `observed`: the result of `jaxtwin.observe`.

    **Returns:** the figure.
    """
    estimates = observed.estimates
    heats = {cell: estimates.heat(cell) for cell in estimates.cells}
    seen = {
        cell: heat for cell, heat in heats.items() if np.any((heat.lower > 0) | (heat.upper < 0))
    }
    ratios = (1.4, 1.4, *((1.0,) if seen else ()), 1.0)
    figure = pyplot.figure(figsize=(9.6, 1.75 * sum(ratios)), layout="constrained")
    grid = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for number, channel in enumerate(observed.channels[:MAX_CHANNELS]):
        readings = observed.expected.recorded
        assert readings is not None
        color = color_of(number)
        grid[0].plot(*joined_samples(observed.time, readings[:, number]), ".", ms=1.5, color=color)
        _band(grid[0], observed, estimates.channel(channel), color, channel)
    grid[0].set(ylabel="channel, °C")
    grid[0].set_title(observed.experiment.name or "recording")
    unseen = [name for name in estimates.nodes if name not in observed.channels]
    hidden = [name for name in unseen if "." in name] or unseen
    for number, name in enumerate(hidden[:MAX_CHANNELS]):
        color = color_of(number)
        _band(grid[1], observed, estimates.node(name), color, name)
    grid[1].set(ylabel="estimated, °C")
    for number, (cell, heat) in enumerate(heats.items() if seen else ()):
        if number < MAX_CHANNELS:
            _band(grid[2], observed, heat, color_of(number), cell)
            grid[2].set(ylabel="unexplained heat, W")
    if heats and not seen:
        widest = max(float(np.max(heat.upper - heat.lower)) / 2 for heat in heats.values())
        title_aside(grid[0], f"no unexplained heat, ± {short_number(widest, 2)} W")
    _band(grid[-1], observed, estimates.room, palette().vermilion, "room")
    grid[-1].set(ylabel="room, °C", xlim=(observed.time[0], observed.time[-1]))
    time_axis(grid[-1], observed.time, observed.experiment.start)
    for axes in grid:
        legend_beside(axes)
    return figure


def _band(axes: Axes, observed: Observed, estimate: Estimate, color: str, label: str) -> None:
    axes.fill_between(observed.time, estimate.lower, estimate.upper, color=color, alpha=0.2, lw=0)
    axes.plot(observed.time, estimate.mean, color=color, lw=1.2, label=label)
