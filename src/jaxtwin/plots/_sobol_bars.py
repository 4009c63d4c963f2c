"""Sobol's indices of an output, for all parameters."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..sensitivity_analysis import GlobalSensitivity
from ._sensitivity_labels import label_rows, title_output
from ._style import palette, styled


@styled
def plot_sobol_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots total (light) and first order (dark) indices, the largest on top; their difference is
    the part of interactions. Lines are 95 % intervals, if the method has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by "sobol" or "pce".
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row = sensitivity.row(output)
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    places = np.arange(len(names), dtype=float)[::-1]
    if ax is None:
        size = (5.6, 1.3 + 0.34 * len(names))
        ax = pyplot.figure(figsize=size, layout="constrained").subplots()
    widest = 0.0
    for name, words, shift, color in (
        ("ST", "ST, with interactions", 0.19, palette().sky),
        ("S1", "S1, alone", -0.19, palette().blue),
    ):
        index = sensitivity[name][row, order]
        ax.barh(places + shift, index, height=0.36, color=color, label=words)
        half = np.zeros(len(order))
        if f"{name}_conf" in sensitivity.indices:
            half = sensitivity[f"{name}_conf"][row, order]
            ax.hlines(places + shift, index - half, index + half, color=palette().ink, lw=1.2)
        widest = max(widest, float(np.nanmax(index + half, initial=0.0)))
    label_rows(ax, names, places)
    ax.set_xlim(right=1.05 * max(widest, 0.05))
    ax.set(xlabel="part of the output's variance")
    ax.legend(loc="lower right")
    title_output(ax, sensitivity, row)
    return ax
