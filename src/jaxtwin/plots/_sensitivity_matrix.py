"""Which parameters matter, for all channels at a glance."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import Sensitivity
from ._style import INK, PALE, palette, points, styled, symbol


@styled
def plot_sensitivity_matrix(sensitivity: Sensitivity, *, ax: Axes | None = None) -> Axes:
    """Correlation of each parameter (columns) with each channel's cost (rows).

    Parameters are sorted by their mean absolute correlation. A number stands where the 95 %
    interval leaves 0 out.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.sensitivity`.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    order = np.argsort(-np.abs(sensitivity.correlation).mean(axis=0), kind="stable")
    correlation = sensitivity.correlation[:, order]
    low, high = np.moveaxis(sensitivity.interval[:, order], -1, 0)
    rows, columns = correlation.shape
    if ax is None:
        size = (2.6 + 0.47 * columns, 1.3 + 0.31 * rows)
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    image = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for row, column in np.argwhere((low > 0) | (high < 0)):
        value = correlation[row, column]
        ax.annotate(
            f"{value:.2f}".replace("0.", "."), (column, row), ha="center", va="center",
            fontsize=points(7.5), color=PALE if abs(value) > 0.55 else INK,
        )  # fmt: skip
    ax.set_xticks(range(columns), [symbol(sensitivity.names[place]) for place in order])
    ax.set_yticks(range(rows), sensitivity.channels)
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.set_title("Correlation of parameters with costs")
    bar = ax.figure.colorbar(image, ax=ax, fraction=0.03, pad=0.01, ticks=[-1, 0, 1])
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.ax.tick_params(length=0, colors=palette().muted)
    return ax
