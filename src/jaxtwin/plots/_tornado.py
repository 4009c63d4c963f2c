"""The correlations of all parameters with the cost of a channel, Fig. 16 of the paper."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import Sensitivity
from ._style import palette, points, styled, symbol


@styled
def plot_tornado(
    sensitivity: Sensitivity, channel: str = "mean", *, ax: Axes | None = None
) -> Axes:
    """Plots the correlation of each parameter with a channel's cost, the strongest on top.

    Lines are the 95 % intervals: a correlation whose interval contains 0 may be chance.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.sensitivity`.
    - `channel`: one of `sensitivity.channels`; `"mean"` is the mean cost of all.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    names = sensitivity.ranking(channel)
    row = sensitivity.channels.index(channel)
    order = [sensitivity.names.index(name) for name in names]
    correlation = sensitivity.correlation[row, order]
    shown = np.round(correlation, 2) + 0.0  # no -0.00
    interval = sensitivity.interval[row, order]
    places = np.arange(len(names))[::-1]
    if ax is None:
        size = (5.6, 1.2 + 0.29 * len(names))
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    colors = [palette().blue if value < 0 else palette().vermilion for value in correlation]
    ax.barh(places, correlation, color=colors, height=0.66, alpha=0.9)
    ax.hlines(places, interval[:, 0], interval[:, 1], color=palette().ink, lw=1.3)
    ax.axvline(0.0, color=palette().muted, lw=0.8)
    for place, value, (low, high) in zip(places, shown, interval, strict=True):
        right = value >= 0
        ax.annotate(
            f"{value:+.2f}".replace("-", "−"), (max(high, 0.0) if right else min(low, 0.0), place),
            xytext=(4 if right else -4, 0), textcoords="offset points",
            ha="left" if right else "right", va="center", fontsize=points(8), color=palette().muted,
        )  # fmt: skip
    ax.set_yticks(places, [symbol(name) for name in names], fontsize=points(10))
    widest = 1.22 * float(np.abs(interval).max()) + 0.02  # with room for the numbers
    ax.set(xlim=(-widest, widest), xlabel="Pearson correlation with the cost")
    ax.set_title("mean of all channels" if channel == "mean" else channel)
    failed = int(np.count_nonzero(sensitivity.failed))
    draws = f"{len(sensitivity.failed):,} draws".replace(",", " ")
    note = f"{draws}, {failed} failed" if failed else draws
    ax.set_title(note, loc="right", fontsize=points(9), fontweight="normal", color=palette().muted)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    return ax
