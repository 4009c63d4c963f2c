"""Estimates with their errors: the correlations of these, values of groups of recordings and of
sessions, the profile of a likelihood, and the differences between two fits.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._arguments import names_of, of_kind
from .._number_text import short_number
from .._statistics import QUANTILE_975
from ..errors import MatchError
from ..matching import Fit, FitDifference, Profile, interval_95, solution_of
from ..prognostics import Health, ParameterHealth
from ..rig import Parameter
from ._layers import draw_bars, draw_correlations, draw_estimates, logarithmic_values
from ._panels import axes_or_new, legend_of_all, panels_in_rows, title_aside, write
from ._style import palette, styled, symbol, with_unit

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
    draw_correlations(ax, correlation, written)
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


GROUP_COLUMNS = 4


@final
class _Row(NamedTuple):
    """The values of a parameter in each group, with their 95 % intervals, and the interval in which
    the value that all groups share is expected."""

    parameter: Parameter
    values: list[float]
    intervals: list[tuple[float, float]]
    shared: tuple[float, float] | None


@styled
def plot_group_values(fits: Fit | Mapping[str, Fit], names: Sequence[str] | None = None) -> Figure:
    """Draws the values of parameters over groups of recordings, with their 95 % intervals, a panel
    for each parameter.

    **Arguments:**

    - `fits`: a match of several groups, whose values of each group are drawn beside the band of the
      value that all groups share; or a match of each group by itself, group -> fit, in order.
    - `names`: the parameters to draw; by default those with a value for each group, or all that
      are free in the first fit and have one value.

    **Returns:** the figure.

    **Raises:** `MatchError` for a match of a single group, no fits, or a parameter without a value
    for each group.
    """
    if isinstance(fits, Fit):
        groups, rows = list(dict.fromkeys(fits.groups.values())), _of_one_match(fits)
    else:
        groups, rows = list(fits), _of_several(fits)
    if names is not None:
        wanted = names_of("plot_group_values: names", names, MatchError)
        missing = [name for name in wanted if name not in rows]
        if missing:
            raise MatchError(
                f"plot_group_values: expected names among {', '.join(rows)}, which have a value "
                f"for each group, got {missing[0]!r}"
            )
        rows = {name: rows[name] for name in wanted}
    figure, panels = panels_in_rows(len(rows), GROUP_COLUMNS, (3.1, 2.1), (0.0, 0.6))
    for axes, row in zip(panels, rows.values(), strict=True):
        _draw_groups(axes, groups, row)
    return figure


def _of_one_match(fit: Fit) -> dict[str, _Row]:
    problem = solution_of(fit).problem
    parameters, _ = problem.unknowns.rows_of_groups()
    if len(problem.group_names) < 2 or not parameters:
        raise MatchError(
            "plot_group_values: expected a match of several groups with parameters of scope group, "
            f"got {fit!r}; pass groups=[...] to match, or a fit of each group"
        )
    errors, values = fit.uncertainty.standard_errors, fit.group_values
    rows = {}
    for parameter in parameters:
        name, result, intervals = parameter.name, [], []
        for group in problem.group_names:
            value, error = values[group][name], errors[f"{name}[{group}]"]
            logarithmic = parameter.is_logarithmic
            relative = error / value if logarithmic else error
            result.append(value)
            intervals.append(interval_95(value, relative, is_logarithmic=logarithmic))
        rows[name] = _Row(parameter, result, intervals, fit[name].interval)
    return rows


def _of_several(fits: Mapping[str, Fit]) -> dict[str, _Row]:
    if not isinstance(fits, Mapping) or not fits:
        raise MatchError(f"plot_group_values: expected a fit or group -> fit, got {fits!r}")
    several = [of_kind("plot_group_values", f, Fit, "a Fit", MatchError) for f in fits.values()]
    rows = {}
    for name, fitted in several[0].parameters.items():
        if fitted.free and fitted.scope != "recording":
            result = [fit[name] for fit in several]
            rows[name] = _Row(
                several[0].twin.rig.parameters[name],
                [row.value for row in result],
                [row.interval for row in result],
                None,
            )
    return rows


def _draw_groups(axes: Axes, groups: Sequence[str], row: _Row) -> None:
    if row.shared is not None and np.isfinite(row.shared).all():
        axes.axhspan(*row.shared, color=palette().sky, alpha=0.25, lw=0, gid="shared")
    places = np.arange(len(groups))
    lower, upper = np.array(row.intervals).T
    draw_estimates(axes, places, row.values, (lower, upper))
    if row.parameter.is_logarithmic:
        logarithmic_values(axes)
    axes.set_xticks(places, groups, rotation=30, ha="right")
    axes.set_xlim(-0.5, len(groups) - 0.5)
    axes.set_title(with_unit(symbol(row.parameter.name), row.parameter.unit))


HEALTH_COLUMNS = 3

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
    figure, grid = panels_in_rows(len(rows), HEALTH_COLUMNS, (3.6, 2.3), (0.0, 1.0))
    for axes, row in zip(grid, rows, strict=True):
        _draw_health(axes, health, row)
    for axes in grid[-HEALTH_COLUMNS:]:
        axes.set_xlabel("session" if health.time_unit == "session" else "days")
    legend_of_all(figure, "outside upper right")
    return figure


def _draw_health(axes: Axes, health: Health, row: ParameterHealth) -> None:
    first, last = row.span
    ahead = health.within if health.probabilities else 0.0
    margin = 0.04 * (last - first + ahead)
    times = np.linspace(first - margin, last + ahead + margin, 200)
    value, lower, upper = row.at(times)
    _, low, high = row.sessions_at(times)
    ends = row.interval_of_sessions()
    draw_estimates(axes, health.times, row.values, ends, label="session, 95 %")
    axes.plot(times, value, color=palette().blue, label="trend")
    light = {"color": palette().sky, "alpha": 0.25, "label": "a session's value, 95 %"}
    axes.fill_between(times, low, high, lw=0, **light)
    dark = {"color": palette().blue, "alpha": 0.35, "label": "trend, 95 %"}
    axes.fill_between(times, lower, upper, lw=0, **dark)
    _choose_range(axes, row, ends)
    axes.set_title(with_unit(symbol(row.name), row.unit))
    note = f"{100 * row.change:+.2g} %" if row.is_logarithmic else f"{row.change:+.2g}"
    if ahead > 0:
        axes.axvline(last, color=palette().muted, lw=0.8)
    if row.limit is not None:
        axes.axhline(row.limit, color=palette().ink, ls="--", lw=1.2, gid="limit", label="limit")
        chance = 100 * row.probability_of_passing(health.within)
        unit = health.time_unit if health.within == 1 else f"{health.time_unit}s"
        note += f"; passes in {short_number(health.within, 3)} {unit}: {chance:.2g} %"
    title_aside(axes, note)
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
    room = np.exp(0.12 * np.log(known.max() / known.min()))
    axes.set_ylim(known.min() / room, known.max() * room)
    logarithmic_values(axes)


# 95 % quantile of chi-squared with one degree of freedom.
CHI2_95 = 3.841


@styled
def plot_profile(profile: Profile, *, ax: Axes | None = None) -> Axes:
    """Plots the increase of the cost with a parameter held at other values.

    Values below the dashed line at 3.84 are inside the 95 % interval, which is shaded as far as the
    profile reaches.

    **Arguments:**

    - `profile`: the result of `jaxtwin.profile`.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    ax = axes_or_new(ax, 5.6, 3.6)
    low, high = np.clip(profile.interval, profile.values[0], profile.values[-1])
    ax.axvspan(low, high, color=palette().sky, alpha=0.35, lw=0, label="95 % interval")
    ax.plot(profile.values, profile.excess, "o-", color=palette().vermilion, ms=5)
    ax.axhline(CHI2_95, color=palette().muted, lw=1.0, ls=(0, (4, 3)))
    limit = {"xycoords": ("axes fraction", "data"), "va": "center", "color": palette().ink}
    write(ax, f"{CHI2_95:.2f}", (1, CHI2_95), (3, 0), **limit)
    ax.set_ylim(bottom=min(0.0, float(profile.excess.min())))
    unit = f", {profile.unit}" if profile.unit else ""
    ax.set(title="Profile likelihood", ylabel="excess of twice the cost")
    ax.set_xlabel(f"{symbol(profile.name)}{unit}")
    ax.legend(loc="upper center")
    return ax


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
    ax = axes_or_new(ax, 5.6, 1.4 + 0.29 * len(known))
    ax.axvspan(-QUANTILE_975, QUANTILE_975, color=palette().faint, lw=0, zorder=0)
    draw_bars(ax, [row.name for row in known], sizes)
    ax.set(xlabel="new less old, standard errors of the difference")
    ax.set_title("difference between two fits; shaded: 95 %")
    return ax
