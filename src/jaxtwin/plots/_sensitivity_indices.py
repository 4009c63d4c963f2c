"""The indices of a global sensitivity analysis, as its method shows them."""

from matplotlib.axes import Axes

from ..sensitivity_analysis import GlobalSensitivity, Morris
from ._index_bars import plot_index_bars
from ._morris_plane import plot_morris_plane
from ._sobol_bars import plot_sobol_bars


def plot_sensitivity_indices(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots Sobol's indices by `plot_sobol_bars`, Morris's by `plot_morris_plane`, any others by
    `plot_index_bars`.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity`.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    if isinstance(sensitivity.method, Morris):
        return plot_morris_plane(sensitivity, output, ax=ax)
    if "S1" in sensitivity.indices:
        return plot_sobol_bars(sensitivity, output, ax=ax)
    return plot_index_bars(sensitivity, output, ax=ax)
