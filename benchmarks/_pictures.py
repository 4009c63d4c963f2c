"""The pictures of the results, as the contents of .png files."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtwin.plots._png import to_png
from jaxtwin.plots._style import palette, styled

Points = Sequence[tuple[int, float]]


def speed_picture(times: Mapping[str, Points]) -> bytes:
    """Draws a second against the number of draws; times are of all draws, s."""

    @styled
    def draw() -> Figure:
        figure, axes = pyplot.subplots(figsize=(7.0, 5.4), layout="constrained")
        rates = {
            name: [(count, count / seconds) for count, seconds in points]
            for name, points in times.items()
        }
        _curves(axes, rates)
        axes.set(xlabel="number of draws", ylabel="draws a second")
        axes.set_title("Random draws of the paper's rig a second: 1000 s at 1 Hz, 15 channels")
        axes.margins(y=0.12)
        figure.legend(loc="outside lower center", ncols=2)
        return figure

    return to_png(draw())


def convergence_picture(errors: Mapping[str, Points]) -> bytes:
    """Worst error of a run against its number of steps, beside lines of order 3 and 4."""

    @styled
    def draw() -> Figure:
        figure, axes = pyplot.subplots(figsize=(6.0, 4.4), layout="constrained")
        _curves(axes, errors)
        steps, worst = np.array(next(iter(errors.values())), dtype=float).T
        for order, dashes in ((3, ":"), (4, "--")):
            line = 0.3 * worst[0] * (steps / steps[0]) ** -float(order)
            axes.loglog(steps, line, dashes, color=palette().muted, label=f"order {order}")
        axes.set(xlabel="steps in 1000 s", ylabel="worst error of a channel, K")
        axes.set_xticks([100, 200, 500, 1000, 2000], ["100", "200", "500", "1000", "2000"])
        axes.set_xticks([], minor=True)
        axes.set_title("The default steps, each cut into ever more parts")
        axes.legend()
        return figure

    return to_png(draw())


def _curves(axes: Axes, curves: Mapping[str, Points]) -> None:
    for (name, points), marker in zip(curves.items(), "osDv^P", strict=False):
        axes.loglog(*zip(*points, strict=True), marker=marker, markersize=5, label=name)
