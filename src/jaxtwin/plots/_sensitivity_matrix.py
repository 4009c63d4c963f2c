"""The correlations of all parameters with the costs of all channels, as a matrix."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import Sensitivity
from ._correlation_matrix import draw_correlation_matrix
from ._style import styled, symbol


@styled
def plot_sensitivity_matrix(sensitivity: Sensitivity, *, ax: Axes | None = None) -> Axes:
    """Plots the correlation of each parameter (columns) with each channel's cost (rows).

    Parameters are sorted by their mean absolute correlation. A cell has a number if its 95 %
    interval does not contain 0.

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
    draw_correlation_matrix(ax, correlation, (low > 0) | (high < 0))
    ax.set_xticks(range(columns), [symbol(sensitivity.names[place]) for place in order])
    ax.set_yticks(range(rows), sensitivity.channels)
    ax.set_title("Correlation of parameters with costs")
    return ax
