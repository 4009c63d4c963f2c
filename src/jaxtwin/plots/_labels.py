"""Labels at the ends of lines, in place of a legend."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ._style import points


def label_ends(
    axes: Axes, ends: Sequence[tuple[float, str, str]], *, spacing: float = 0.055
) -> None:
    """Writes a label to the right of each line's end, moved up or down if two would overlap.

    **Arguments:**

    - `axes`: the axes with the lines, whose y limits are fixed from then on.
    - `ends`: the last value, the label and the colour of each line; a line without a value (NaN)
      has no label.
    - `spacing`: the distance between two labels, as a part of the height of the axes.
    """
    ends = [end for end in ends if not np.isnan(end[0])]
    if not ends:
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high)
    heights = (np.array([value for value, _, _ in ends]) - low) / (high - low)
    for (_, label, color), height in zip(ends, space_apart(heights, spacing), strict=True):
        axes.annotate(
            label,
            (1.0, height),
            xycoords="axes fraction",
            xytext=(4, 0),
            textcoords="offset points",
            color=color,
            fontsize=points(9),
            va="center",
            annotation_clip=False,
        )


def space_apart(positions: Float[np.ndarray, " n"], spacing: float) -> Float[np.ndarray, " n"]:
    """Moves positions so that they are at least `spacing` apart, as little as possible.

    This is isotonic regression: the positions minus multiples of the spacing must not decrease, and
    neighbours that do are pooled.
    """
    order = np.argsort(positions, kind="stable")
    wanted = positions[order] - spacing * np.arange(len(positions))
    pools: list[list[float]] = []
    for value in wanted:
        pools.append([value])
        while len(pools) > 1 and np.mean(pools[-2]) > np.mean(pools[-1]):
            last = pools.pop()
            pools[-1] += last
    level = np.concatenate([np.full(len(pool), np.mean(pool)) for pool in pools])
    moved = np.empty_like(positions)
    moved[order] = level + spacing * np.arange(len(positions))
    return moved
