"""The distribution of the results of many draws, channel by channel."""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from ..errors import SimulationError
from ._panels import caption, panels, write_in_the_middle
from ._style import palette, styled, unit_text

if TYPE_CHECKING:
    import xarray

# The largest number of draws that are read: the quantiles of more draws would look the same.
MAX_DRAWS = 100_000

# The largest number of panels side by side.
MAX_PANELS_ABREAST = 3

# The largest number of values with a row each; more values are points of a curve.
MAX_ROWS = 40

# The shortest axis as a part of its largest number: draws that are the same but for their last
# digits lie on a line, and five digits distinguish the ticks.
MIN_SPAN = 1e-4


@styled
def plot_distributions(draws: "xarray.Dataset") -> Figure:
    """Plots the medians, the quartiles and the 5 and 95 % quantiles over the draws, a panel for
    each quantity, three panels side by side.

    Draws that failed (NaN) are left out, and infinite values, such as the settling time of a loop
    that never settles, are counted below the panel. A quantity with more than 40 values for each
    draw, such as a trajectory, is drawn as a curve with bands. Of a sweep with very many draws the
    first 100 000 finished draws are shown.

    **Arguments:**

    - `draws`: a dataset with the dimension draw, such as `Reductions.to_xarray` and `open_sweep`
      return.

    **Returns:** the figure.

    **Raises:** `SimulationError` if the dataset has no quantity over draws.
    """
    names = [
        str(name)
        for name, values in draws.data_vars.items()
        if "draw" in values.dims and "parameter" not in values.dims and values.dtype.kind == "f"
    ]
    if not names or draws.sizes["draw"] == 0:
        raise SimulationError(
            f"plot_distributions: expected quantities over draws, got {', '.join(names) or 'none'} "
            f"over {draws.sizes.get('draw', 0)} draws; ask reduce_batch for them"
        )
    first = draws[names].isel(draw=slice(MAX_DRAWS))
    quantities = [_columns(first[name]) for name in names]
    lines = math.ceil(len(names) / MAX_PANELS_ABREAST)
    across = math.ceil(len(names) / lines)
    heights = [_rows(labels) for labels, _ in quantities]
    tallest = [max(heights[line * across : (line + 1) * across]) for line in range(lines)]
    size = (1.0 + 3.2 * across, 0.3 + lines + 0.24 * sum(tallest))
    figure, grid = panels(lines, across, *size, height_ratios=tallest)
    for axes in grid.flat[len(names) :]:
        axes.remove()
    for axes, name, (labels, values) in zip(grid.flat, names, quantities, strict=False):
        unit = unit_text(str(draws[name].attrs.get("units", "")))
        axes.set_title(name)
        if len(labels) > MAX_ROWS:
            _draw_curve(axes, values)
            axes.set(xlabel=f"number of the value, {_infinite(values)}".rstrip(", "), ylabel=unit)
        else:
            _draw_rows(axes, labels, values)
            axes.set_xlabel(", ".join(filter(None, (unit, _infinite(values)))))
    caption(figure, f"{first.sizes['draw']} draws: median, quartiles, 5 to 95 %")
    return figure


def _rows(labels: list[str]) -> int:
    """The height of a panel, in rows."""
    return len(labels) if len(labels) <= MAX_ROWS else 6


def _draw_rows(axes: Axes, labels: list[str], values: Float[np.ndarray, "draws rows"]) -> None:
    """Draws a row of its own for each value."""
    places = np.arange(len(labels))
    low, lower, median, upper, high = _quantiles(values)
    axes.hlines(places, low, high, color=palette().muted, lw=1.2)
    axes.hlines(places, lower, upper, color=palette().sky, lw=7)
    axes.plot(median, places, "o", color=palette().ink, ms=4)
    axes.set_yticks(places, labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    if np.isnan(median).all():
        axes.set_xticks([])
        write_in_the_middle(axes, "no finite value")
        return
    axes.set_xlim(_widened(*axes.get_xlim()))
    axes.xaxis.set_major_locator(MaxNLocator(3, steps=(1, 2, 5, 10), min_n_ticks=2))
    _write_plainly(axes.xaxis)


def _draw_curve(axes: Axes, values: Float[np.ndarray, "draws points"]) -> None:
    """Draws many values in their order, with bands between the quantiles."""
    places = np.arange(values.shape[1])
    low, lower, median, upper, high = _quantiles(values)
    axes.fill_between(places, low, high, color=palette().muted, alpha=0.25, lw=0)
    axes.fill_between(places, lower, upper, color=palette().sky, alpha=0.7, lw=0)
    axes.plot(places, median, color=palette().ink, lw=1.2)
    axes.set_xlim(places[0], places[-1])
    axes.set_ylim(_widened(*axes.get_ylim()))
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=(1, 2, 5, 10)))
    _write_plainly(axes.yaxis)


def _widened(low: float, high: float) -> tuple[float, float]:
    """The ends of an axis, at least `MIN_SPAN` apart."""
    least = MIN_SPAN * max(abs(low), abs(high))
    if high - low >= least:
        return low, high
    middle = (low + high) / 2
    return middle - least / 2, middle + least / 2


def _write_plainly(axis: Axis) -> None:
    """Writes whole numbers at the ticks, without one that has to be added to them."""
    numbers = ScalarFormatter(useOffset=False)
    numbers.set_powerlimits((-4, 6))
    axis.set_major_formatter(numbers)


def _infinite(values: Float[np.ndarray, "draws rows"]) -> str:
    """How many draws have an infinite value; nothing if none has."""
    count = int(np.isinf(values).any(axis=1).sum())
    return f"infinite in {count} of {len(values)}" if count else ""


def _columns(values: "xarray.DataArray") -> tuple[list[str], np.ndarray]:
    """A quantity as `(draws, rows)` with a label for each row."""
    others = [dim for dim in values.dims if dim != "draw"]
    if not others:
        return [""], values.to_numpy()[:, None]
    stacked = values.stack(row=others)
    labels = [
        ", ".join(map(str, np.atleast_1d(np.array(row, dtype=object))))
        for row in stacked.row.values
    ]
    return labels, stacked.transpose("draw", "row").to_numpy()


def _quantiles(values: np.ndarray) -> np.ndarray:
    """The 5, 25, 50, 75 and 95 % quantiles of each column, NaN for a column without numbers."""
    result = np.full((5, values.shape[1]), np.nan)
    for number, column in enumerate(values.T):
        there = column[np.isfinite(column)]
        if there.size:
            result[:, number] = np.quantile(there, (0.05, 0.25, 0.5, 0.75, 0.95))
    return result
