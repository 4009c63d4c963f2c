"""The result of a sensitivity analysis: correlations with costs (Fig. 16 of the paper), and indices
as their method shows them: bars and Morris's plane.
"""

import numpy as np
from matplotlib.axes import Axes

from ..sensitivity_analysis import GlobalSensitivity, Morris, Sensitivity
from ._index_curves import INDEX_WORDS, interval_of, title_output
from ._layers import draw_bars, draw_correlations, label_rows
from ._panels import axes_or_new, title_aside, write
from ._style import palette, rim, styled, symbol, with_unit


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
    draw_correlations(ax, correlation, (low > 0) | (high < 0))
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
    low, high = sensitivity.interval[row, order].T
    ax = axes_or_new(ax, 5.6, 1.2 + 0.29 * len(names))
    places = draw_bars(ax, names, correlation, (low, high))
    shown = np.round(correlation, 2) + 0.0  # no -0.00
    for place, value, left, right in zip(places, shown, low, high, strict=True):
        end, shift, ha = (max(right, 0), 4, "left") if value >= 0 else (min(left, 0), -4, "right")
        text = f"{value:+.2f}".replace("-", "−")
        write(ax, text, (end, place), (shift, 0), size=8, ha=ha, va="center")
    widest = 1.22 * float(np.abs([low, high]).max()) + 0.02  # with room for the numbers
    ax.set(xlim=(-widest, widest), xlabel="Pearson correlation with the cost")
    ax.set_title("mean of all channels" if channel == "mean" else channel)
    failed = int(np.count_nonzero(sensitivity.failed))
    draws = f"{len(sensitivity.failed):,} draws".replace(",", " ")
    title_aside(ax, f"{draws}, {failed} failed" if failed else draws)
    return ax


def plot_sensitivity_indices(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots Sobol's indices by `plot_sobol_bars`, Morris's by `plot_morris_plane`, any others by
    `plot_index_bars`.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity`.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    if isinstance(sensitivity.method, Morris):
        return plot_morris_plane(sensitivity, output, ax=ax)
    if "S1" in sensitivity.indices:
        return plot_sobol_bars(sensitivity, output, ax=ax)
    return plot_index_bars(sensitivity, output, ax=ax)


@styled
def plot_index_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the main index of each parameter, the largest on top, with 95 % intervals if the method
    has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by any method.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row, main = sensitivity.row(output), sensitivity.method.main
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    low, high = (end[row, order] for end in interval_of(sensitivity.indices, main))
    ax = axes_or_new(ax, 5.6, 1.2 + 0.29 * len(names))
    draw_bars(ax, names, sensitivity[main][row, order], (low, high))
    unit = sensitivity.outputs[row].unit if main == "swing" else ""
    ax.set_xlabel(with_unit(INDEX_WORDS[main], unit))
    title_output(ax, sensitivity, row)
    return ax


@styled
def plot_sobol_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots total (light) and first order (dark) indices, the largest on top; their difference is
    the part of interactions. Lines are 95 % intervals, if the method has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by "sobol" or "pce".
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row = sensitivity.row(output)
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    places = np.arange(len(names), dtype=float)[::-1]
    ax = axes_or_new(ax, 5.6, 1.3 + 0.34 * len(names))
    widest = 0.05
    for name, words, shift, color in (
        ("ST", "ST, with interactions", 0.19, palette().sky),
        ("S1", "S1, alone", -0.19, palette().blue),
    ):
        index = sensitivity[name][row, order]
        ax.barh(places + shift, index, height=0.36, color=color, label=words)
        low, high = (end[row, order] for end in interval_of(sensitivity.indices, name))
        if np.isfinite(high).any():
            ax.hlines(places + shift, low, high, color=palette().ink, lw=1.2)
        widest = max(widest, float(np.nanmax([index, high], initial=0.0)))
    label_rows(ax, names, places)
    ax.set_xlim(right=1.05 * widest)
    ax.set(xlabel="part of the output's variance")
    ax.legend(loc="lower right")
    title_output(ax, sensitivity, row)
    return ax


# The part of the largest effect from which on a parameter has its name beside its point.
NAMED_FRACTION = 0.05

NAME_HEIGHT, NAME_WIDTH = 0.055, 0.1
"""The height and the width of a name, as parts of the axes."""


@styled
def plot_morris_plane(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the standard deviation of each parameter's elementary effects over their mean absolute
    value with its 95 % interval. Parameters on the right have large effects, and those far up have
    nonlinear effects or interactions.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by "morris".
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row = sensitivity.row(output)
    mu_star, sigma = sensitivity["mu_star"][row], sensitivity["sigma"][row]
    half = sensitivity["mu_star_conf"][row]
    ax = axes_or_new(ax, 5.6, 4.2)
    look = {"color": palette().blue, "ecolor": palette().muted, "elinewidth": 1.0, "ms": 5}
    ax.errorbar(mu_star, sigma, xerr=half, fmt="o", **look)
    limit = 1.15 * float(np.nanmax(mu_star + half, initial=1e-300))
    top = 1.15 * float(np.nanmax([sigma.max(initial=0.0), 0.2 * limit]))
    diagonal = min(limit, top)
    ax.plot([0, diagonal], [0, diagonal], color=palette().muted, lw=0.9, ls=(0, (4, 3)))
    beside = {"ha": "right", "va": "center", "path_effects": rim()}
    write(ax, "sigma = mu_star", (0.97 * diagonal, 0.97 * diagonal), (-4, 0), size=8, **beside)
    ax.set(xlim=(0, limit), ylim=(-0.02 * top, top))
    written: list[tuple[float, float]] = []
    for column in np.argsort(sigma, kind="stable"):
        if mu_star[column] >= NAMED_FRACTION * mu_star.max():
            x, y = mu_star[column] / limit, sigma[column] / top
            # A name is placed above that of a neighbour if the two would touch.
            above = max(
                [y, *(other + NAME_HEIGHT for at, other in written if abs(at - x) < NAME_WIDTH)]
            )
            written.append((x, above))
            look = {"size": 10, "color": palette().ink, "path_effects": rim()}
            write(ax, symbol(sensitivity.names[column]), (x * limit, above * top), (5, 5), **look)
    unit = sensitivity.outputs[row].unit
    ax.set_xlabel(with_unit("mu_star, mean size of the effects", unit))
    ax.set_ylabel(with_unit("sigma", unit))
    title_output(ax, sensitivity, row)
    return ax
