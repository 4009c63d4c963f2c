"""Samples that are missing, and spans that count less in a match, for all pictures."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..simulation import Run
from ._style import palette


def of_sampled(
    run: Run, weights: Float[np.ndarray, "times channels"]
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
                float(time[part[0]]), float(end), color=palette().faint,
                alpha=0.35 + 0.65 * missing, lw=0,
                zorder=0.4, gid="masked",
            )  # fmt: skip


def masked_key(weights: Iterable[Float[np.ndarray, "_ _"]]) -> list[Patch]:
    """The legend of the shading; empty without any."""
    shaded = any(bool((weight < 1).any()) for weight in weights)
    return [Patch(color=palette().faint, lw=0, label="counted less")] if shaded else []


def mean_there(values: Float[np.ndarray, "rows columns"], axis: int) -> Float[np.ndarray, " kept"]:
    """The mean along an axis; NaN where nothing is there.

    **Arguments:**

    - `values`: NaN where a sample is missing.
    """
    there = ~np.isnan(values)
    counts = there.sum(axis=axis)
    sums = np.sum(values, axis=axis, where=there)
    return np.divide(sums, counts, out=np.full(counts.shape, np.nan), where=counts > 0)


def last_means(
    values: Float[np.ndarray, "times channels"], samples: int
) -> Float[np.ndarray, " channels"]:
    """The mean of the last samples of each channel that are there; NaN where it has none.

    **Arguments:**

    - `samples`: how many; at least one counts.
    """
    ends = [column[~np.isnan(column)][-max(1, samples) :] for column in values.T]
    return np.array([end.mean() if end.size else np.nan for end in ends])
