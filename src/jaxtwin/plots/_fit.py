"""The result of a match: its course (Fig. 14 of the paper), and the parameters beside their initial
and published values (Table 4).
"""

import math

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from .._number_text import interval_text, short_number
from ..matching import Fit, FittedParameter, interval_95
from ._panels import legend_of_all, panels, write
from ._style import palette, points, styled, symbol, unit_text

HISTORY_COLUMNS = 6  # panels of parameters in a row


@styled
def plot_history(fit: Fit) -> Figure:
    """Plots the RMSE and the free parameters over the iterations.

    Rejected steps are open dots in the first panel. Dotted lines are bounds, which are drawn if the
    parameter came near them; a parameter that ends at a bound has an orange title.

    **Arguments:**

    - `fit`: the result of `jaxtwin.match`.

    **Returns:** the figure.
    """
    free = [parameter for parameter in fit.parameters.values() if parameter.free]
    rows = math.ceil(len(free) / HISTORY_COLUMNS)
    figure = pyplot.figure(figsize=(12.6, max(2.8, 0.7 + 1.45 * rows)), layout="constrained")
    grid = figure.add_gridspec(rows, HISTORY_COLUMNS + 2)
    cost = figure.add_subplot(grid[:, :2])
    _draw_rmse(cost, fit)
    for number, parameter in enumerate(free):
        row, column = divmod(number, HISTORY_COLUMNS)
        axes = figure.add_subplot(grid[row, 2 + column], sharex=cost)
        _draw_parameter(axes, fit, parameter)
        if number + HISTORY_COLUMNS < len(free):
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("iteration", fontsize=points(9))
    return figure


def _draw_rmse(axes: Axes, fit: Fit) -> None:
    numbers = np.array([iteration.number for iteration in fit.history])
    rmse = np.array([iteration.rmse for iteration in fit.history])
    refused = np.array([not iteration.accepted for iteration in fit.history])
    best = np.minimum.accumulate(rmse)
    axes.plot(numbers, best, color=palette().vermilion, lw=1.8)
    hollow = {"mfc": "none", "mec": palette().muted, "ms": 4, "label": "step taken back"}
    axes.plot(numbers[refused], rmse[refused], "o", **hollow)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_ylim(best[-1] / 1.15, min(rmse.max(), 3 * best[0]) * 1.1)
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set(title="RMSE, K", xlabel="iteration")
    if refused.any():
        axes.legend(loc="upper right", handletextpad=0)
    look = {"size": 10, "ha": "right", "color": palette().vermilion, "fontweight": "bold"}
    write(axes, f"{best[-1]:.2f} K", (numbers[-1], best[-1]), (0, 7), **look)


def _draw_parameter(axes: Axes, fit: Fit, parameter: FittedParameter) -> None:
    numbers = [iteration.number for iteration in fit.history]
    own = [key for key in fit.history[0].values if key.startswith(f"{parameter.name}[")]
    keys = own or [parameter.name]
    values = np.array([[step.values[key] for key in keys] for step in fit.history])
    for column, color in zip(values.T, palette().cycle * len(keys), strict=False):
        axes.plot(numbers, column, color=color if own else palette().blue, lw=1.6)
    for bound in (parameter.lower, parameter.upper):
        if math.isfinite(bound) and np.any(np.isclose(values, bound, rtol=1e-3)):
            axes.axhline(bound, color=palette().ink, lw=1.2, ls=":")
    if values.min() > 0 and values.max() > 10 * values.min():
        axes.set_yscale("log")
        # Within two decades there would be only one or two powers of ten as labels.
        few = values.max() < 100 * values.min()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 3) if few else (1,), numticks=4))
        axes.yaxis.set_major_formatter(lambda value, _: short_number(value))
        axes.minorticks_off()
    else:
        axes.yaxis.set_major_locator(MaxNLocator(3))
        if np.abs(values).max() < 1e-3:  # else matplotlib writes a power of ten over the title
            axes.yaxis.set_major_formatter(lambda value, _: short_number(value))
    axes.tick_params(labelsize=7.5, pad=2)
    color = palette().vermilion if parameter.at_bound else palette().ink
    axes.set_title(symbol(parameter.name), fontsize=points(10), color=color, pad=3)
    unit = unit_text(parameter.unit)
    axes.set_title(
        unit, loc="right", fontsize=points(7.5), color=palette().muted, fontweight="normal", pad=3
    )


@styled
def plot_parameters(fit: Fit) -> Figure:
    """Draws the free parameters as a table, and the position of each between its bounds.

    A line through a matched value is its 95 % interval, as far as the bounds reach; the darker part
    of the bar contains 95 % of its prior. The scale is logarithmic for parameters above 0. For a
    parameter with a value for each recording, their mean is shown. The warnings of the match follow
    each value.

    **Arguments:**

    - `fit`: the result of `jaxtwin.match`.

    **Returns:** the figure.
    """
    free = [parameter for parameter in fit.parameters.values() if parameter.free]
    size = (13.4, 1.3 + 0.3 * len(free))
    figure, ((table, scale),) = panels(1, 2, *size, width_ratios=(1.0, 1.08), sharey=True)
    _write_table(table, free)
    for place, parameter in enumerate(free):
        _draw_position(scale, place, parameter)
    scale.set_ylim(len(free) - 0.4, -1.2)
    scale.set_xlim(-0.03, 1.42)
    write(scale, "lower bound", (0, -0.8), ha="left", va="center")
    write(scale, "upper bound", (1, -0.8), ha="right", va="center")
    scale.set_axis_off()
    legend_of_all(figure, "outside lower right")
    quality = f"mean fit {fit.mean_fit_percent:.1f} %, RMSE {fit.rmse:.2f} K"
    figure.suptitle(f"{fit.twin.rig.name}: {quality}", x=0.01, ha="left")
    return figure


def _draw_position(axes: Axes, place: int, parameter: FittedParameter) -> None:
    """Draws where a parameter began, was published and ended between its bounds."""
    colors = palette()
    row = [place, place]
    axes.plot([0, 1], row, color=colors.faint, lw=7, solid_capstyle="round", zorder=1)
    if parameter.prior_value is not None:
        span = [_position(end, parameter) for end in _prior_interval(parameter)]
        look = {"alpha": 0.4, "solid_capstyle": "butt", "gid": "prior", "zorder": 1.5}
        axes.plot(span, row, color=colors.muted, lw=7, label="95 % of its prior", **look)
    initial, value = (_position(at, parameter) for at in (parameter.initial, parameter.value))
    axes.plot([initial, value], row, color=colors.muted, lw=1.0, zorder=2)
    if not math.isnan(parameter.interval[0]):
        span = [_position(end, parameter) for end in parameter.interval]
        look = {"alpha": 0.45, "solid_capstyle": "butt", "gid": "interval", "zorder": 2.5}
        axes.plot(span, row, color=colors.vermilion, lw=3.5, label="its 95 % interval", **look)
    look = {"mfc": colors.ground, "ms": 6, "zorder": 3}
    axes.plot(initial, place, "o", mec=colors.ink, label="initial", **look)
    if parameter.published is not None:
        at = _position(parameter.published, parameter)
        look = {"mfc": colors.ground, "mew": 1.4, "ms": 5.5, "zorder": 4}
        axes.plot(at, place, "D", mec=colors.blue, label="published", **look)
    axes.plot(value, place, "o", color=colors.vermilion, ms=7, zorder=5, label="matched")
    color = colors.vermilion if parameter.at_bound else colors.ink
    write(axes, ", ".join(parameter.warnings), (1.04, place), size=8.5, color=color, va="center")


def _write_table(axes: Axes, free: list[FittedParameter]) -> None:
    matched = {"color": palette().vermilion, "fontweight": "bold"}
    unit = {"ha": "left", "color": palette().muted, "size": 8.5}
    columns = {"initial": 0.27, "published": 0.43, "matched": 0.60, "95 % interval": 0.99}
    for heading, at in columns.items():
        write(axes, heading, (at, -0.8), ha="right", va="center")
    for place, parameter in enumerate(free):
        published = "-" if parameter.published is None else short_number(parameter.published)
        for at, text, look in (
            (0.0, symbol(parameter.name), {"ha": "left"}),
            (columns["initial"], short_number(parameter.initial), {}),
            (columns["published"], published, {"color": palette().blue}),
            (columns["matched"], short_number(parameter.value), matched),
            (0.62, unit_text(parameter.unit), unit),
            (columns["95 % interval"], interval_text(parameter.interval), {}),
        ):
            look = {"size": 10, "color": palette().ink, "ha": "right", "va": "center", **look}
            write(axes, text, (at, place), **look)
    axes.set_xlim(0, 1)
    axes.set_axis_off()


def _prior_interval(parameter: FittedParameter) -> tuple[float, float]:
    """The interval that contains 95 % of the prior of a single value."""
    assert parameter.prior_value is not None
    assert parameter.prior_spread is not None
    deviation = math.hypot(parameter.prior_spread, parameter.group_spread or 0.0)
    return interval_95(parameter.prior_value, deviation, is_logarithmic=parameter.is_logarithmic)


def _position(value: float, parameter: FittedParameter) -> float:
    """The position of a value between its bounds: 0 at the lower bound or below, 1 at the upper
    bound or above."""
    lower, upper = parameter.lower, parameter.upper
    if not (math.isfinite(lower) and math.isfinite(upper)):
        ends = (parameter.initial, parameter.value)
        lower, upper = min(ends) - 1, max(ends) + 1
    value = min(max(value, lower), upper)
    if parameter.is_logarithmic and lower > 0:
        value, lower, upper = math.log(value), math.log(lower), math.log(upper)
    return (value - lower) / (upper - lower)
