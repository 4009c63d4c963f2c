"""The distribution of the results of many draws, channel by channel."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from .._errors import SimulationError
from ._style import palette, points, styled
from ._units import unit_text

if TYPE_CHECKING:
    import xarray

MOST = 100_000
"""The largest number of draws that are read: the quantiles of more draws would look the same."""


@styled
def plot_distributions(draws: "xarray.Dataset") -> Figure:
    """Plots the medians, the quartiles and the 5 and 95 % quantiles over the draws, a panel for
    each quantity.

    Draws that failed (NaN) are left out. Of a sweep with very many draws the first 100 000 finished
    draws are shown.

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
            f"over {draws.sizes.get('draw', 0)} draws; ask simulate_batch for reductions"
        )
    first = draws[names].isel(draw=slice(MOST))
    columns = [_columns(first[name]) for name in names]
    tallest = max(len(labels) for labels, _ in columns)
    figure = pyplot.figure(
        figsize=(1.0 + 3.2 * len(names), 1.3 + 0.24 * tallest), layout="constrained"
    )
    grid = figure.subplots(1, len(names), squeeze=False)[0]
    for axes, name, (labels, values) in zip(grid, names, columns, strict=True):
        places = np.arange(len(labels))
        low, lower, median, upper, high = _quantiles(values)
        axes.hlines(places, low, high, color=palette().muted, lw=1.2)
        axes.hlines(places, lower, upper, color=palette().sky, lw=7)
        axes.plot(median, places, "o", color=palette().ink, ms=4)
        axes.set_yticks(places, labels)
        axes.set_ylim(len(labels) - 0.4, -0.6)
        unit = unit_text(str(draws[name].attrs.get("units", "")))
        axes.set(title=name, xlabel=unit)
    figure.supxlabel(
        f"{first.sizes['draw']} draws: median, quartiles, 5 to 95 %", fontsize=points(9),
        color=palette().muted,
        x=0.01, ha="left",
    )  # fmt: skip
    return figure


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
    found = np.full((5, values.shape[1]), np.nan)
    for number, column in enumerate(values.T):
        there = column[np.isfinite(column)]
        if there.size:
            found[:, number] = np.quantile(there, (0.05, 0.25, 0.5, 0.75, 0.95))
    return found
