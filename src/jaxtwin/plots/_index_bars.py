"""A sensitivity index of an output, for all parameters."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import GlobalSensitivity
from ._sensitivity_labels import INDEX_WORDS, label_rows, title_output
from ._style import palette, styled
from ._units import unit_text


@styled
def plot_index_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the main index of each parameter, the largest on top, with 95 % intervals if the method
    has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by any method.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row, main = sensitivity.row(output), sensitivity.method.main
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    index = sensitivity[main][row, order]
    places = np.arange(len(names), dtype=float)[::-1]
    if ax is None:
        size = (5.6, 1.2 + 0.29 * len(names))
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    colors = [palette().blue if value < 0 else palette().vermilion for value in index]
    ax.barh(places, index, color=colors, height=0.66, alpha=0.9)
    known = sensitivity.indices
    if f"{main}_conf" in known:
        half = known[f"{main}_conf"][row, order]
        ax.hlines(places, index - half, index + half, color=palette().ink, lw=1.3)
    elif f"{main}_low" in known:
        low, high = known[f"{main}_low"][row, order], known[f"{main}_high"][row, order]
        ax.hlines(places, low, high, color=palette().ink, lw=1.3)
    label_rows(ax, names, places)
    ax.set(xlabel=INDEX_WORDS[main])
    unit = unit_text(sensitivity.outputs[row].unit)
    if main == "swing" and unit:
        ax.set_xlabel(f"{INDEX_WORDS[main]}, {unit}")
    title_output(ax, sensitivity, row)
    return ax
