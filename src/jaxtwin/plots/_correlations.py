"""Correlations: of matched values' errors, and of parameters with the cost of channels (Fig. 16 of
the paper).
"""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from ..matching import Fit
from ..sensitivity_analysis import Sensitivity
from ._panels import axes_or_new, title_aside
from ._style import INK, PALE, palette, points, styled, symbol

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
    ax = axes_or_new(ax, 2.4 + cell * count, 1.6 + 0.86 * cell * count)
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
    ax = axes_or_new(ax, 2.6 + 0.47 * columns, 1.3 + 0.31 * rows)
    draw_correlation_matrix(ax, correlation, (low > 0) | (high < 0))
    ax.set_xticks(range(columns), [symbol(sensitivity.names[place]) for place in order])
    ax.set_yticks(range(rows), sensitivity.channels)
    ax.set_title("Correlation of parameters with costs")
    return ax


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
    ax = axes_or_new(ax, 5.6, 1.2 + 0.29 * len(names))
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
    title_aside(ax, note)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)
    return ax


def draw_correlation_matrix(
    ax: Axes,
    correlation: Float[np.ndarray, "rows columns"],
    written: Bool[np.ndarray, "rows columns"],
) -> None:
    """Draws the cells, the numbers and the colour bar. The caller writes the labels.

    **Arguments:**

    - `correlation`: -1 to 1; a cell that is NaN stays empty.
    - `written`: the cells whose number is written.
    """
    image = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for row, column in np.argwhere(written):
        value = correlation[row, column]
        ax.annotate(
            f"{value:.2f}".replace("0.", "."), (column, row), ha="center", va="center",
            fontsize=points(7.5), color=PALE if abs(value) > 0.55 else INK,
        )  # fmt: skip
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    bar = ax.figure.colorbar(image, ax=ax, fraction=0.03, pad=0.01, ticks=[-1, 0, 1])
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.ax.tick_params(length=0, colors=palette().muted)
