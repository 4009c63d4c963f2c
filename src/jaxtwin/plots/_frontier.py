"""The trade between two aims of a controller."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib import pyplot
from matplotlib.figure import Figure

from ..control import MEASURES, Frontier
from ._style import palette, points, rim, styled
from ._units import unit_text

# The part of the range of a panel within which dots cover each other.
OVERLAP_FRACTION = 0.02


@styled
def plot_frontier(frontier: Frontier, measure: str, beside: Sequence[str]) -> Figure:
    """Plots a measure over other measures, with a panel for each.

    A dot is the median over the draws of the plant, and its bars extend from 5 to 95 % of the
    draws. The numbers are the weights; dots that cover each other share a text. A thin line joins
    the dots in their order. A hollow dot is not on the frontier of its panel: another
    controller is better in both measures. A controller with a median that is not finite, such as
    the settling time of a loop that never settles, is left out.

    **Arguments:**

    - `frontier`: the result of `jaxtwin.control.frontier`.
    - `measure`: the measure on the vertical axis.
    - `beside`: the measures on the horizontal axes.

    **Returns:** the figure.

    **Raises:** `ControlError` for an unknown measure.
    """
    figure = pyplot.figure(figsize=(1 + 4.4 * len(beside), 4.2), layout="constrained")
    panels = figure.subplots(1, len(beside), sharey=True, squeeze=False)[0]
    y = _quantiles(frontier, measure)
    for axes, name in zip(panels, beside, strict=True):
        x = _quantiles(frontier, name)
        is_shown = np.isfinite(x[1]) & np.isfinite(y[1])
        order = np.flatnonzero(is_shown)[np.argsort(x[1][is_shown])]
        best = [
            point
            for point in order
            if not np.any((x[1][order] < x[1][point]) & (y[1][order] < y[1][point]))
        ]
        axes.plot(x[1][is_shown], y[1][is_shown], color=palette().faint, lw=1.2)
        axes.plot(x[1][best], y[1][best], color=palette().blue, lw=1.2)
        for point in order:
            axes.plot(x[[0, 2], point], [y[1, point]] * 2, color=palette().blue, lw=1, alpha=0.5)
            axes.plot([x[1, point]] * 2, y[[0, 2], point], color=palette().blue, lw=1, alpha=0.5)
            fill = palette().blue if point in best else "none"
            axes.plot(x[1, point], y[1, point], "o", mfc=fill, mec=palette().blue, ms=5)
        for together in _neighbours(x[1], y[1], order):
            axes.annotate(
                ", ".join(f"{weight:g}" for weight in sorted(frontier.weights[together])),
                (x[1, together[0]], y[1, together[0]]), (5, 5),
                textcoords="offset points", fontsize=points(8), color=palette().muted,
                path_effects=rim(),
            )  # fmt: skip
        axes.margins(x=0.1)
        axes.set_xlabel(_label(name))
    panels[0].set_ylabel(_label(measure))
    unit = unit_text(MEASURES[frontier.against][1])
    unit = f"({unit})" if " " in unit else unit
    panels[0].set_title(
        f"weight of {frontier.against.replace('_', ' ')}" + (f", 1/{unit}" if unit else "")
    )
    return figure


def _quantiles(frontier: Frontier, name: str) -> Float[np.ndarray, "3 points"]:
    """The 5, 50 and 95 % quantiles over the draws; NaN between infinite values."""
    with np.errstate(invalid="ignore"):
        return np.quantile(frontier.measure(name), [0.05, 0.5, 0.95], axis=1)


def _neighbours(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], order: Int[np.ndarray, " n"]
) -> list[list[int]]:
    """Groups of points whose dots cover each other, so that their numbers share a text."""
    near = [OVERLAP_FRACTION * np.ptp(values[order]) if len(order) else 0.0 for values in (x, y)]
    groups: list[list[int]] = []
    for point in order:
        for group in groups:
            first = group[0]
            if abs(x[point] - x[first]) <= near[0] and abs(y[point] - y[first]) <= near[1]:
                group.append(int(point))
                break
        else:
            groups.append([int(point)])
    return groups


def _label(name: str) -> str:
    unit = unit_text(MEASURES[name][1])
    return name.replace("_", " ") + (f", {unit}" if unit else "")
