"""The readings of an observed recording, with what was expected of them."""

import numpy as np
from matplotlib.axes import Axes

from ..observers import Observed
from ._samples import joined_samples
from ._style import palette, points

# The largest number of channels.
MAX_CHANNELS = 8


def draw_readings(axes: Axes, observed: Observed) -> None:
    """Draws the readings of the first channels as dots and what was expected as lines."""
    readings = np.asarray(observed.experiment.temperatures)
    for number, channel in enumerate(observed.channels[:MAX_CHANNELS]):
        color = palette().cycle[number % len(palette().cycle)]
        axes.plot(*joined_samples(observed.time, readings[:, number]), ".", ms=1.5, color=color)
        expected = observed.expected.mean[:, number]
        axes.plot(observed.time, expected, color=color, lw=0.8, label=channel)
    axes.set(ylabel="channel, °C")
    axes.set_title(observed.experiment.name or "recording")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=points(8))
