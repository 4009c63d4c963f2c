r"""Compresses a recording to as many samples in each step as the step can distinguish.

Temperatures at the samples of one step are $W c$, with $c$ the six values and slopes around it.
With $W = Q R$,

$$\lVert W c - y \rVert^2 = \lVert R c - Q^T y \rVert^2 + \lVert y - Q Q^T y \rVert^2,$$

so that six combinations stand for all samples of a long step. Missing samples are left out of $W$
and $y$; the samples of a step in which channels miss different ones stay as they are.
"""

from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._padded_rows import padded
from ._interpolation import POWERS
from ._time_grid import TimeGrid


@final
class CompressedRecording(eqx.Module):
    """The combinations of a recording's samples that suffice for its mean squared error.

    - `grid`: the time grid, with combinations of samples in place of samples.
    - `target`: the same combinations of the recorded temperatures, degC; `ones`: those of a
      constant 1. Padded rows are zeros, as are their weights.
    - `counted`: whether a combination counts in a channel: 0 for a missing sample, otherwise 1.
    - `beyond`: the mean square of the part that no values at the steps can represent, K^2.
    - `samples`: the number of samples of each channel.
    """

    grid: TimeGrid
    target: Float[Array | np.ndarray, "rows channels"]
    ones: Float[Array | np.ndarray, " rows"]
    counted: Float[Array | np.ndarray, "rows channels"]
    beyond: Float[Array | np.ndarray, " channels"]
    samples: Float[Array | np.ndarray, " channels"]


def compress(grid: TimeGrid, recorded: Float[np.ndarray, "times channels"]) -> CompressedRecording:
    """Compresses the recording of an experiment on its grid, padded or not, degC. Missing samples
    are NaN."""
    count = len(recorded)
    there = ~np.isnan(recorded)
    used = there.any(axis=1)
    step_of, whole = np.asarray(grid.step_of)[:count][used], there[used].all(axis=1)
    weights = np.asarray(grid.weights)[:count][used]
    samples = np.column_stack([weights, np.nan_to_num(recorded[used]), np.ones(len(step_of))])
    # Samples follow each other in time, and so do those of a step.
    steps, first, counts = np.unique(step_of, return_index=True, return_counts=True)
    is_long = (counts > POWERS) & np.logical_and.reduceat(whole, first)
    short = ~np.repeat(is_long, counts)
    # The samples of each long step in a separate table, padded with zeros. One factorisation of all
    # tables is faster than a loop over steps, which would take longer than many draws.
    place = np.arange(counts.max())
    filled = place < counts[is_long, None]
    own = samples[np.where(filled, first[is_long, None] + place, 0)]
    w, y = np.split(np.where(filled[:, :, None], own, 0.0), [POWERS], axis=2)
    q, r = np.linalg.qr(w)
    projected = np.swapaxes(q, 1, 2) @ y
    beyond = np.sum((y - q @ projected) ** 2, axis=(0, 1))[:-1]
    combined = np.concatenate([r, projected], axis=2).reshape(-1, samples.shape[1])
    rows = padded(np.concatenate([samples[short], combined]), 0.0)
    rows_of = padded(np.concatenate([step_of[short], np.repeat(steps[is_long], POWERS)]))
    every = np.ones((len(combined), there.shape[1]))
    counted = padded(np.concatenate([there[used][short], every]), 0.0)
    return CompressedRecording(
        grid=eqx.tree_at(lambda s: (s.step_of, s.weights), grid, (rows_of, rows[:, :POWERS])),
        target=rows[:, POWERS:-1],
        ones=rows[:, -1],
        counted=counted,
        beyond=beyond / there.sum(axis=0),
        samples=there.sum(axis=0).astype(float),
    )
