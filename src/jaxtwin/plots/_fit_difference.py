"""The differences between the parameters of two fits."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from .._normal_distribution import QUANTILE_975
from ..matching import FitDifference
from ._sensitivity_labels import label_rows
from ._style import palette, styled


@styled
def plot_fit_difference(difference: FitDifference, *, ax: Axes | None = None) -> Axes:
    """Plots the difference of each parameter in standard errors, the largest on top.

    95 % of the differences between two matches of one rig to different recordings lie in the
    band. Parameters without a standard error are left out.

    **Arguments:**

    - `difference`: the result of `jaxtwin.compare_fits`.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    known = [row for row in difference.rows if row.error > 0]
    known.sort(key=lambda row: -abs(row.standard_errors))
    sizes = np.array([row.standard_errors for row in known])
    places = np.arange(len(known), dtype=float)[::-1]
    if ax is None:
        size = (5.6, 1.4 + 0.29 * len(known))
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    ax.axvspan(-QUANTILE_975, QUANTILE_975, color=palette().faint, lw=0, zorder=0)
    colors = [palette().blue if size < 0 else palette().vermilion for size in sizes]
    ax.barh(places, sizes, color=colors, height=0.66, alpha=0.9, zorder=2)
    label_rows(ax, [row.name for row in known], places)
    ax.set(xlabel="new less old, standard errors of the difference")
    ax.set_title("difference between two fits; shaded: 95 %")
    return ax
