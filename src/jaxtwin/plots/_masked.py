"""Spans of a recording that count less in a match, for all pictures that show one."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ._style import FAINT

if TYPE_CHECKING:
    from ..simulation import Run


def of_sampled(
    run: "Run", weights: Float[np.ndarray, "times channels"]
) -> Float[np.ndarray, "times channels"]:
    """The weights of a run's samples, 1 where one is missing: that is a gap in the line."""
    return np.where(run.experiment.sampled, weights, 1.0)


def shade_masked(
    axes: Axes, time: Float[np.ndarray, " times"], weights: Float[np.ndarray, "times channels"]
) -> None:
    """Shades where a sample of any channel counts less than fully, the darker the less.

    **Arguments:**

    - `axes`: whose x axis is the time, s.
    - `weights`: 0 to 1.
    """
    weight = weights.min(axis=1)
    edges = np.flatnonzero(np.diff(weight)) + 1
    for part in np.split(np.arange(len(time)), edges):
        if (missing := 1 - float(weight[part[0]])) > 0:
            end = time[min(part[-1] + 1, len(time) - 1)]
            axes.axvspan(
                float(time[part[0]]), float(end), color=FAINT, alpha=0.35 + 0.65 * missing, lw=0,
                zorder=0.4, gid="masked",
            )  # fmt: skip


def masked_key(weights: Iterable[Float[np.ndarray, "_ _"]]) -> list[Patch]:
    """What a legend says of the shading; nothing where there is none."""
    shaded = any(bool((weight < 1).any()) for weight in weights)
    return [Patch(color=FAINT, lw=0, label="counted less")] if shaded else []
