"""A matrix of correlations as coloured cells, with numbers in some of them."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from ._style import INK, PALE, palette, points


def draw_correlation_matrix(
    ax: Axes,
    correlation: Float[np.ndarray, "rows columns"],
    written: Bool[np.ndarray, "rows columns"],
) -> None:
    """Draws the cells, the numbers and the colour bar. The caller writes the labels.

    **Arguments:**

    - `correlation`: -1 to 1; a cell that is NaN stays empty.
    - `written`: the cells whose number is written.
    """
    image = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for row, column in np.argwhere(written):
        value = correlation[row, column]
        ax.annotate(
            f"{value:.2f}".replace("0.", "."), (column, row), ha="center", va="center",
            fontsize=points(7.5), color=PALE if abs(value) > 0.55 else INK,
        )  # fmt: skip
    ax.tick_params(length=0)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    bar = ax.figure.colorbar(image, ax=ax, fraction=0.03, pad=0.01, ticks=[-1, 0, 1])
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.ax.tick_params(length=0, colors=palette().muted)
