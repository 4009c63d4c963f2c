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
from ..matching import Fit, FittedParameter
from ..matching._fitted_parameters import interval_95
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
    numbers = [iteration.number for iteration in fit.history]
    rmse = np.array([iteration.rmse for iteration in fit.history])
    accepted = np.array([iteration.accepted for iteration in fit.history])
    best = np.minimum.accumulate(rmse)
    axes.plot(numbers, best, color=palette().vermilion, lw=1.8)
    axes.plot(
        np.array(numbers)[~accepted], rmse[~accepted], "o", mfc="none", mec=palette().muted, ms=4
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_ylim(best[-1] / 1.15, min(rmse.max(), 3 * best[0]) * 1.1)
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set(title="RMSE, K", xlabel="iteration")
    if not accepted.all():
        axes.plot([], [], "o", mfc="none", mec=palette().muted, ms=4, label="step taken back")
        axes.legend(loc="upper right", handletextpad=0)
    axes.annotate(
        f"{best[-1]:.2f} K", (numbers[-1], best[-1]), xytext=(0, 7), textcoords="offset points",
        ha="right", color=palette().vermilion, fontweight="bold",
    )  # fmt: skip


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
    figure = pyplot.figure(figsize=(13.4, 1.3 + 0.3 * len(free)), layout="constrained")
    table, scale = figure.subplots(1, 2, width_ratios=(1.0, 1.08), sharey=True)
    _write_table(table, free)
    for place, parameter in enumerate(free):
        scale.plot(
            [0, 1], [place, place], color=palette().faint, lw=7, solid_capstyle="round", zorder=1
        )
        if parameter.prior_value is not None:
            span = [_position(end, parameter) for end in _prior_interval(parameter)]
            scale.plot(
                span, [place, place], color=palette().muted, lw=7, alpha=0.4,
                solid_capstyle="butt", zorder=1.5, gid="prior",
            )  # fmt: skip
        ends = [_position(value, parameter) for value in (parameter.initial, parameter.value)]
        scale.plot(ends, [place, place], color=palette().muted, lw=1.0, zorder=2)
        if not math.isnan(parameter.interval[0]):
            span = [_position(end, parameter) for end in parameter.interval]
            scale.plot(
                span, [place, place], color=palette().vermilion, lw=3.5, alpha=0.45,
                solid_capstyle="butt",
                zorder=2.5, gid="interval",
            )  # fmt: skip
        scale.plot(ends[0], place, "o", mfc=palette().ground, mec=palette().ink, ms=6, zorder=3)
        if parameter.published is not None:
            at = _position(parameter.published, parameter)
            scale.plot(
                at, place, "D", mfc=palette().ground, mec=palette().blue, mew=1.4, ms=5.5, zorder=4
            )
        scale.plot(ends[1], place, "o", color=palette().vermilion, ms=7, zorder=5)
        color = palette().vermilion if parameter.at_bound else palette().ink
        warnings = ", ".join(parameter.warnings)
        _write(scale, 1.04, place, warnings, ha="left", color=color, fontsize=points(8.5))
    scale.set_ylim(len(free) - 0.4, -1.2)
    scale.set_xlim(-0.03, 1.42)
    for text, at, ha in (("lower bound", 0, "left"), ("upper bound", 1, "right")):
        scale.annotate(
            text, (at, -0.8), ha=ha, va="center", fontsize=points(9), color=palette().muted
        )
    scale.set_axis_off()
    handles = [
        scale.plot([], [], "o", mfc=palette().ground, mec=palette().ink, ms=6, label="initial")[0],
        scale.plot(
            [],
            [],
            "D",
            mfc=palette().ground,
            mec=palette().blue,
            mew=1.4,
            ms=5.5,
            label="published",
        )[0],
        scale.plot([], [], "o", color=palette().vermilion, ms=7, label="matched")[0],
        scale.plot(
            [], [], color=palette().vermilion, lw=3.5, alpha=0.45, label="its 95 % interval"
        )[0],
    ]
    if any(parameter.prior_value is not None for parameter in free):
        handles += scale.plot(
            [], [], color=palette().muted, lw=7, alpha=0.4, label="95 % of its prior"
        )
    if all(parameter.published is None for parameter in free):
        del handles[1]
    figure.legend(handles=handles, loc="outside lower right", ncols=5)
    figure.suptitle(
        f"{fit.twin.rig.name}: mean fit {fit.mean_fit_percent:.1f} %, RMSE {fit.rmse:.2f} K",
        x=0.01, ha="left",
    )  # fmt: skip
    return figure


def _write_table(axes: Axes, free: list[FittedParameter]) -> None:
    columns = {"initial": 0.27, "published": 0.43, "matched": 0.60, "95 % interval": 0.99}
    for heading, at in columns.items():
        axes.annotate(
            heading, (at, -0.8), ha="right", va="center", fontsize=points(9), color=palette().muted
        )
    for place, parameter in enumerate(free):
        _write(axes, 0.0, place, symbol(parameter.name), ha="left")
        _write(axes, columns["initial"], place, short_number(parameter.initial))
        published = "-" if parameter.published is None else short_number(parameter.published)
        _write(axes, columns["published"], place, published, color=palette().blue)
        _write(
            axes, columns["matched"], place, short_number(parameter.value),
            color=palette().vermilion, fontweight="bold",
        )  # fmt: skip
        unit = unit_text(parameter.unit)
        _write(axes, 0.62, place, unit, ha="left", color=palette().muted, fontsize=points(8.5))
        _write(axes, columns["95 % interval"], place, interval_text(parameter.interval))
    axes.set_xlim(0, 1)
    axes.set_axis_off()


def _write(axes: Axes, x: float, y: int, text: str, ha: str = "right", **look) -> None:
    axes.text(x, y, text, ha=ha, va="center", **look)


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
