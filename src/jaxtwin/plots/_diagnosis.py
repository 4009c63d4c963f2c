"""A recording that was diagnosed: readings, and the probabilities of what explains them."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..diagnosis import Diagnosis
from ..diagnosis._diagnosis import HEALTHY, NONE_OF_THESE
from ._readings import draw_readings
from ._style import palette, points, styled

# The largest number of channels, and of faults with a colour of their own.
MAX_CHANNELS = 8

# A fault that is never likelier than this is among the others.
SEEN = 0.05


@styled
def plot_diagnosis(diagnosis: Diagnosis) -> Figure:
    """Plots what a diagnosis found.

    The panels are the readings with what was expected of them, and the probabilities over time,
    given the readings up to then, stacked; a dashed line is the onset of a cause.

    **Arguments:**

    - `diagnosis`: the result of `jaxtwin.diagnose`.

    **Returns:** the figure.
    """
    figure = pyplot.figure(figsize=(9.6, 5.4), layout="constrained")
    grid = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
    draw_readings(grid[0], diagnosis.observed)
    _probabilities(grid[1], diagnosis)
    for axes in grid:
        for cause in diagnosis.causes:
            axes.axvline(cause.onset, color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    grid[1].set(xlabel="time, s", xlim=(diagnosis.time[0], diagnosis.time[-1]))
    return figure


def _probabilities(axes: Axes, diagnosis: Diagnosis) -> None:
    table = diagnosis.probabilities
    names = list(diagnosis.names)
    largest = table.max(axis=0)
    order = np.argsort(-largest)
    shown = [
        int(n) for n in order if names[n] not in (HEALTHY, NONE_OF_THESE) and largest[n] >= SEEN
    ]
    shown = sorted(shown[:MAX_CHANNELS], key=lambda n: int(table[:, n].argmax()))
    rest = [
        n for n, name in enumerate(names) if n not in shown and name not in (HEALTHY, NONE_OF_THESE)
    ]
    layers = [(HEALTHY, table[:, names.index(HEALTHY)], palette().faint)]
    layers += [
        (names[n], table[:, n], palette().cycle[place % len(palette().cycle)])
        for place, n in enumerate(shown)
    ]
    layers += [
        ("other suspects", table[:, rest].sum(axis=1), palette().muted),
        (NONE_OF_THESE, table[:, names.index(NONE_OF_THESE)], palette().ink),
    ]
    kept = [layer for layer in layers if layer[1].max() >= SEEN]
    axes.stackplot(
        diagnosis.time,
        [one[1] for one in kept],
        colors=[one[2] for one in kept],
        labels=[one[0] for one in kept],
        linewidth=0,
    )
    axes.set(ylabel="probability", ylim=(0, 1))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=points(8), reverse=True)
