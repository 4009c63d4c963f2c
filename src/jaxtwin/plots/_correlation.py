"""The correlations of the errors of matched values."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..matching import Fit
from ._correlation_matrix import draw_correlation_matrix
from ._style import styled, symbol

# Correlations whose size is above this are written as numbers, if the cells are large enough.
SHOWN = 0.5

CELL, WIDEST = 0.42, 11.0
"""The width of a cell, and the largest width of all cells together, inches; many cells become
smaller."""

# The smallest width of a cell with a number in it, inches.
MIN_FOR_NUMBERS = 0.3


@styled
def plot_correlation(fit: Fit, *, ax: Axes | None = None) -> Axes:
    """Plots the correlations of the errors of all matched values.

    If a correlation is near 1 or -1, the recordings do not distinguish the two values. A cell is
    empty if a value was held at a bound or nothing determines it.

    **Arguments:**

    - `fit`: the result of `jaxtwin.match`.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    correlation = np.where(
        np.isfinite(fit.uncertainty.correlation), fit.uncertainty.correlation, np.nan
    )
    count = len(correlation)
    cell = min(CELL, WIDEST / count)
    if ax is None:
        size = (2.4 + cell * count, 1.6 + 0.86 * cell * count)
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    written = np.abs(np.nan_to_num(correlation)) > SHOWN
    written &= ~np.eye(count, dtype=bool) & (cell > MIN_FOR_NUMBERS)
    draw_correlation_matrix(ax, correlation, written)
    labels = [_label(label) for label in fit.uncertainty.labels]
    ax.set_xticks(range(count), labels, rotation=90)
    ax.set_yticks(range(count), labels)
    ax.tick_params(labelsize=min(9.0, 30 * cell))
    ax.set_title("Correlation of the matched values")
    return ax


def _label(label: str) -> str:
    """The symbol of a parameter, and the recording to which it belongs."""
    name, _, recording = label.partition("[")
    where = f", {recording.removesuffix(']')}" if recording else ""
    return symbol(name) + where.replace("$", r"\$")
