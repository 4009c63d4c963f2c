"""The health of a rig: its parameters over sessions."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from .._number_text import short_number
from ..prognostics import Health, ParameterHealth
from ._style import palette, points, styled, symbol
from ._units import unit_text

COLUMNS = 3

# The largest number of parameters; those with limits are first, then those that changed most.
MAX_PARAMETERS = 9


@styled
def plot_health(health: Health) -> Figure:
    """Plots parameters over sessions, a panel for each.

    A dot is what a session says by itself, with its 95 % interval. The line is the trend, with the
    95 % interval of the trend (dark) and of the value of a session (light); it goes on as far as
    limits are looked at. A dashed line is a limit.

    **Arguments:**

    - `health`: the result of `jaxtwin.health`.

    **Returns:** the figure.
    """
    rows = sorted(health.parameters.values(), key=lambda row: row.limit is None)[:MAX_PARAMETERS]
    columns = min(COLUMNS, len(rows))
    height = -(-len(rows) // columns)
    figure = pyplot.figure(figsize=(3.6 * columns, 1.0 + 2.3 * height), layout="constrained")
    panels = figure.subplots(height, columns, squeeze=False, sharex=True).ravel()
    ahead = health.within if health.probabilities else 0.0
    for axes, row in zip(panels, rows, strict=False):
        _draw(axes, health, row, ahead)
    for axes in panels[max(0, len(rows) - columns) : len(rows)]:
        axes.tick_params(labelbottom=True)  # the lowest panel of each column
        axes.set_xlabel("session" if health.time_unit == "session" else "days")
    for axes in panels[len(rows) :]:
        axes.set_axis_off()
    color = palette().vermilion
    handles = [
        Line2D([], [], color=color, marker="o", lw=3, alpha=0.6, label="session, 95 %"),
        Line2D([], [], color=palette().blue, label="trend"),
        Patch(color=palette().blue, alpha=0.35, lw=0, label="trend, 95 %"),
        Patch(color=palette().sky, alpha=0.25, lw=0, label="a session's value, 95 %"),
    ]
    if any(row.limit is not None for row in rows):
        handles.append(Line2D([], [], color=palette().ink, ls="--", label="limit"))
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure


def _draw(axes: Axes, health: Health, row: ParameterHealth, ahead: float) -> None:
    first, last = row.span
    margin = 0.04 * (last - first + ahead)
    times = np.linspace(first - margin, last + ahead + margin, 200)
    value, lower, upper = row.at(times)
    _, low, high = row.sessions_at(times)
    axes.fill_between(times, low, high, color=palette().sky, alpha=0.25, lw=0)
    axes.fill_between(times, lower, upper, color=palette().blue, alpha=0.35, lw=0)
    axes.plot(times, value, color=palette().blue)
    ends = row.interval_of_sessions()
    axes.vlines(health.times, *ends, color=palette().vermilion, lw=3, alpha=0.45, gid="interval")
    axes.plot(health.times, row.values, "o", color=palette().vermilion, ms=5)
    _choose_range(axes, row, ends)
    quantity = unit_text(row.unit)
    axes.set_title(symbol(row.name) + (f", {quantity}" if quantity else ""))
    note = f"{100 * row.change:+.2g} %" if row.is_logarithmic else f"{row.change:+.2g}"
    if ahead > 0:
        axes.axvline(last, color=palette().muted, lw=0.8)
    if row.limit is not None:
        axes.axhline(row.limit, color=palette().ink, ls="--", lw=1.2, gid="limit")
        chance = 100 * row.probability_of_passing(health.within)
        unit = health.time_unit if health.within == 1 else f"{health.time_unit}s"
        note += f"; passes in {short_number(health.within, 3)} {unit}: {chance:.2g} %"
    axes.set_title(note, loc="right", fontsize=points(9), fontweight="normal")
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def _choose_range(axes: Axes, row: ParameterHealth, ends: tuple[np.ndarray, np.ndarray]) -> None:
    """A range of values that the sessions fill: a session that knows little may reach out of it."""
    usual = row.errors <= 2 * np.nanmedian(row.errors)
    known = np.concatenate([row.values[np.isfinite(row.values)], *(end[usual] for end in ends)])
    if row.limit is not None:
        known = np.append(known, row.limit)
    if not row.is_logarithmic:
        room = 0.12 * np.ptp(known)
        axes.set_ylim(known.min() - room, known.max() + room)
        return
    axes.set_yscale("log")
    room = np.exp(0.12 * np.log(known.max() / known.min()))
    axes.set_ylim(known.min() / room, known.max() * room)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
