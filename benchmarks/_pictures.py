"""The pictures of the results, as the contents of .png files."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtwin.plots._style import palette, styled, to_png

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


def confusion_picture(columns: Sequence[str], rows: Mapping[str, Sequence[int]]) -> bytes:
    """A matrix of what was said of each fault: the share of its runs as a colour, and their
    number."""
    counts = np.array(list(rows.values()))
    shares = counts / counts.sum(axis=1, keepdims=True)

    @styled
    def draw() -> Figure:
        size = (1.9 + 0.52 * len(columns), 1.6 + 0.42 * len(rows))
        figure, axes = pyplot.subplots(figsize=size, layout="constrained")
        shown = np.ma.masked_equal(shares, 0.0)
        colors = pyplot.get_cmap("viridis_r").with_extremes(bad=palette().faint)
        axes.imshow(shown, vmin=0, vmax=1, cmap=colors, aspect="auto")
        for row, column in np.argwhere(counts > 0):
            axes.annotate(
                f"{counts[row, column]}",
                (column, row),
                ha="center",
                va="center",
                color="white" if shares[row, column] > 0.5 else "black",
            )
        axes.grid(visible=False)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_xticks(range(len(columns)), columns, rotation=45, ha="right")
        axes.set_yticks(range(len(rows)), list(rows))
        axes.set(xlabel="named as", ylabel="fault")
        return figure

    return to_png(draw())
