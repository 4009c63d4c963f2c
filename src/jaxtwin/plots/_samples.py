"""Missing samples, and spans with a lower weight in a match, as all pictures show them."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..io._gaps import GAP_FACTOR
from ..simulation import Run
from ._style import palette


def weights_of_samples(
    run: Run, weights: Float[np.ndarray, "times channels"]
) -> Float[np.ndarray, "times channels"]:
    """Returns the weights of a run's samples. A missing sample gets the weight 1, because it is
    already a gap in the line."""
    return np.where(run.experiment.sampled, weights, 1.0)


def shade_masked(
    axes: Axes, time: Float[np.ndarray, " times"], weights: Float[np.ndarray, "times channels"]
) -> None:
    """Shades the times at which a sample of any channel has a weight below 1; lower weights are
    darker.

    **Arguments:**

    - `axes`: axes with the time as x axis, s.
    - `weights`: the weights of the samples, 0 to 1.
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
    """Returns the legend entry of the shading; empty if nothing is shaded."""
    shaded = any(bool((weight < 1).any()) for weight in weights)
    return [Patch(color=palette().faint, lw=0, label="counted less")] if shaded else []


def mean_of_samples(
    values: Float[np.ndarray, "rows columns"], axis: int
) -> Float[np.ndarray, " kept"]:
    """Computes the mean along an axis over the samples that exist; NaN if there are none.

    **Arguments:**

    - `values`: the samples; NaN for a missing one.
    """
    there = ~np.isnan(values)
    counts = there.sum(axis=axis)
    sums = np.sum(values, axis=axis, where=there)
    return np.divide(sums, counts, out=np.full(counts.shape, np.nan), where=counts > 0)


def means_of_last_samples(
    values: Float[np.ndarray, "times channels"], samples: int
) -> Float[np.ndarray, " channels"]:
    """Computes the mean of the last existing samples of each channel; NaN if it has none.

    **Arguments:**

    - `samples`: the number of samples; at least one is used.
    """
    ends = [column[~np.isnan(column)][-max(1, samples) :] for column in values.T]
    return np.array([end.mean() if end.size else np.nan for end in ends])


def joined_samples(
    time: Float[np.ndarray, " times"], readings: Float[np.ndarray, " times"]
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """The samples that exist, as the points of a line: a sensor that is read less often than the
    recording has rows is a line as well, and where samples were lost the line has a gap."""
    there = ~np.isnan(readings)
    if np.count_nonzero(there) < 2 or np.median(np.diff(np.flatnonzero(there))) <= 1:
        return time, readings  # as often as the rows
    result, values = time[there], readings[there]
    steps = np.diff(result)
    (lost,) = np.nonzero(steps > GAP_FACTOR * np.median(steps))
    return np.insert(result, lost + 1, np.nan), np.insert(values, lost + 1, np.nan)
