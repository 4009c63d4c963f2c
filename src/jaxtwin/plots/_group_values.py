"""The changes between groups of recordings, such as days or sessions."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, final

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from .._arguments import names_of, of_kind
from ..errors import MatchError
from ..matching import Fit
from ..matching._fit import solution_of
from ..matching._fitted_parameters import interval_95
from ..rig import Parameter
from ._style import palette, styled, symbol
from ._units import unit_text

COLUMNS = 4


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
    columns = min(COLUMNS, len(rows))
    height = -(-len(rows) // columns)
    figure = pyplot.figure(figsize=(3.1 * columns, 0.6 + 2.1 * height), layout="constrained")
    panels = figure.subplots(height, columns, squeeze=False, sharex=True).ravel()
    for axes, row in zip(panels, rows.values(), strict=False):
        _draw(axes, groups, row)
    for axes in panels[max(0, len(rows) - columns) : len(rows)]:
        axes.tick_params(labelbottom=True)  # the lowest panel of each column
    for axes in panels[len(rows) :]:
        axes.set_axis_off()
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


def _draw(axes: Axes, groups: Sequence[str], row: _Row) -> None:
    places = np.arange(len(groups))
    if row.shared is not None and np.isfinite(row.shared).all():
        axes.axhspan(*row.shared, color=palette().sky, alpha=0.25, lw=0, gid="shared")
    lower, upper = np.array(row.intervals).T
    axes.vlines(places, lower, upper, color=palette().vermilion, lw=3, alpha=0.45, gid="interval")
    axes.plot(places, row.values, "o", color=palette().vermilion, ms=6)
    if row.parameter.is_logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(_log_ticks(*axes.get_ylim()))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(places, groups, rotation=30, ha="right")
    axes.set_xlim(-0.5, len(groups) - 0.5)
    unit = unit_text(row.parameter.unit)
    axes.set_title(symbol(row.parameter.name) + (f", {unit}" if unit else ""))


def _log_ticks(low: float, high: float) -> Locator:
    """Ticks at 1, 2 and 5 times powers of ten, or at round numbers if fewer than two of the former
    lie in the range."""
    powers = LogLocator(subs=(1, 2, 5))
    seen = [tick for tick in powers.tick_values(low, high) if low <= tick <= high]
    return powers if len(seen) > 1 else MaxNLocator(4)
