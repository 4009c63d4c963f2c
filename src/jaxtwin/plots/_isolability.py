"""Which faults can be found and told apart, as a matrix of times."""

import numpy as np
from matplotlib import pyplot
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from ..diagnosis import Isolability
from ._style import palette, points, styled

# The largest number of faults whose times are written into the matrix.
MAX_LABELLED_FAULTS = 24


@styled
def plot_isolability(isolability: Isolability) -> Figure:
    """Plots after what time faults are found and told apart.

    On the left is the time after which each fault of its usual size is found. A cell of the matrix
    is the time after which the fault of its row is told from that of its column, of any size. What
    stays empty does not happen within the duration.

    **Arguments:**

    - `isolability`: the result of `jaxtwin.isolability`.

    **Returns:** the figure.
    """
    names = isolability.names
    count = len(names)
    side = max(3.0, 0.34 * count if count <= MAX_LABELLED_FAULTS else 0.2 * count)
    figure = pyplot.figure(figsize=(side + 3.6, side + 1.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, max(count, 2)))
    norm = LogNorm(1.0, max(isolability.duration, 2.0))
    colors = pyplot.get_cmap("viridis_r").with_extremes(bad=palette().faint)
    image = None
    for axes, times in (
        (left, isolability.detection[:, None]), (right, isolability.separation)
    ):  # fmt: skip
        shown = np.ma.masked_invalid(np.maximum(times, 1.0))
        image = axes.imshow(shown, norm=norm, cmap=colors, aspect="auto")
        axes.grid(visible=False)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        if count <= MAX_LABELLED_FAULTS:
            for row, column in np.argwhere(np.isfinite(times)):
                dark = float(times[row, column]) > isolability.duration**0.5
                axes.annotate(
                    f"{times[row, column]:.0f}", (column, row), ha="center", va="center",
                    fontsize=points(7), color="#ffffff" if dark else "#000000",
                )  # fmt: skip
    size = points(8 if count <= MAX_LABELLED_FAULTS else 6)
    left.set_yticks(range(count), names, fontsize=size)
    left.set_xticks([0], ["found"], rotation=90, fontsize=size)
    right.set_xticks(range(count), names, rotation=90, fontsize=size)
    title = f"{isolability.rig}, {len(isolability.channels)} channels"
    figure.suptitle(f"{title}: found, and told apart, after so many seconds")
    assert image is not None
    bar = figure.colorbar(image, ax=right, fraction=0.03, pad=0.01)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure
