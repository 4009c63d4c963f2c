"""Morris's plane of elementary effects."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import GlobalSensitivity
from ._sensitivity_labels import title_output
from ._style import palette, points, rim, styled, symbol
from ._units import unit_text

# The part of the largest effect from which on a parameter has its name beside its point.
NAMED_FRACTION = 0.05


LINE, WORD = 0.055, 0.1
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
    if ax is None:
        ax = pyplot.figure(figsize=(5.6, 4.2), layout="constrained").subplots()
    half = sensitivity["mu_star_conf"][row]
    ax.errorbar(
        mu_star,
        sigma,
        xerr=half,
        fmt="o",
        color=palette().blue,
        ecolor=palette().muted,
        elinewidth=1.0,
        ms=5,
    )
    limit = 1.15 * float(np.nanmax(mu_star + half, initial=1e-300))
    top = 1.15 * float(np.nanmax([sigma.max(initial=0.0), 0.2 * limit]))
    diagonal = min(limit, top)
    ax.plot([0, diagonal], [0, diagonal], color=palette().muted, lw=0.9, ls=(0, (4, 3)))
    ax.annotate(
        "sigma = mu_star", (0.97 * diagonal, 0.97 * diagonal), xytext=(-4, 0),
        textcoords="offset points", ha="right", va="center", fontsize=points(8),
        color=palette().muted, path_effects=rim(),
    )  # fmt: skip
    unit = unit_text(sensitivity.outputs[row].unit)
    ends = f", {unit}" if unit else ""
    ax.set(xlim=(0, limit), ylim=(-0.02 * top, top))
    written: list[tuple[float, float]] = []
    for column in np.argsort(sigma, kind="stable"):
        if mu_star[column] >= NAMED_FRACTION * mu_star.max():
            x, y = mu_star[column] / limit, sigma[column] / top
            # A name is placed above that of a neighbour if the two would touch.
            above = max([y, *(other + LINE for at, other in written if abs(at - x) < WORD)])
            written.append((x, above))
            ax.annotate(
                symbol(sensitivity.names[column]), (x * limit, above * top), xytext=(5, 5),
                textcoords="offset points", color=palette().ink, path_effects=rim(),
            )  # fmt: skip
    ax.set(xlabel=f"mu_star, mean size of the effects{ends}", ylabel=f"sigma{ends}")
    title_output(ax, sensitivity, row)
    return ax
