"""The course of a match, Fig. 14 of the paper."""

import math

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from .._number_text import short_number
from ..matching import Fit, FittedParameter
from ._style import palette, points, styled, symbol
from ._units import unit_text

COLUMNS = 6  # panels of parameters in a row


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
    rows = math.ceil(len(free) / COLUMNS)
    figure = pyplot.figure(figsize=(12.6, max(2.8, 0.7 + 1.45 * rows)), layout="constrained")
    grid = figure.add_gridspec(rows, COLUMNS + 2)
    cost = figure.add_subplot(grid[:, :2])
    _draw_rmse(cost, fit)
    for number, parameter in enumerate(free):
        row, column = divmod(number, COLUMNS)
        axes = figure.add_subplot(grid[row, 2 + column], sharex=cost)
        _draw_parameter(axes, fit, parameter)
        if number + COLUMNS < len(free):
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
