r"""A recording with no more samples in a step than the step can tell apart.

Temperatures at the samples of one step are $W c$, with $c$ the six values and slopes around it.
With $W = Q R$,

$$\lVert W c - y \rVert^2 = \lVert R c - Q^T y \rVert^2 + \lVert y - Q Q^T y \rVert^2,$$

so that six combinations stand for all samples of a long step.
"""

from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ._interpolation import POWERS
from ._padding import padded
from ._schedule import Schedule


@final
class CompressedRecording(eqx.Module):
    """What is left of a recording for the sake of its mean squared error.

    - `schedule`: with combinations of samples for samples.
    - `target`: the recorded temperatures combined alike, degC; `ones`: a constant 1 combined alike.
      Rows that fill up their number are zeros, as are their weights.
    - `beyond`: the mean square of what no temperatures around the steps could follow, K^2.
    - `samples`: how many there were.
    """

    schedule: Schedule
    target: Float[Array | np.ndarray, "rows channels"]
    ones: Float[Array | np.ndarray, " rows"]
    beyond: Float[Array | np.ndarray, " channels"]
    samples: Float[Array | np.ndarray, ""]


def compress(
    schedule: Schedule, recorded: Float[np.ndarray, "times channels"]
) -> CompressedRecording:
    """The recording of an experiment on its schedule, filled up or not, degC."""
    count = len(recorded)
    step_of = np.asarray(schedule.step_of)[:count]
    samples = np.column_stack([schedule.weights[:count], recorded, np.ones(count)])
    # Samples follow each other in time, and so do those of a step.
    steps, first, counts = np.unique(step_of, return_index=True, return_counts=True)
    is_long = counts > POWERS
    short = ~np.repeat(is_long, counts)
    # The samples of each long step in a table of its own, filled up with nothing: one
    # factorisation of all, as a loop over steps would take longer than many a draw.
    place = np.arange(counts.max())
    filled = place < counts[is_long, None]
    own = samples[np.where(filled, first[is_long, None] + place, 0)]
    w, y = np.split(np.where(filled[:, :, None], own, 0.0), [POWERS], axis=2)
    q, r = np.linalg.qr(w)
    seen = np.swapaxes(q, 1, 2) @ y
    beyond = np.sum((y - q @ seen) ** 2, axis=(0, 1))[:-1]
    combined = np.concatenate([r, seen], axis=2).reshape(-1, samples.shape[1])
    rows = padded(np.concatenate([samples[short], combined]), 0.0)
    rows_of = padded(np.concatenate([step_of[short], np.repeat(steps[is_long], POWERS)]))
    return CompressedRecording(
        schedule=eqx.tree_at(
            lambda s: (s.step_of, s.weights), schedule, (rows_of, rows[:, :POWERS])
        ),
        target=rows[:, POWERS:-1],
        ones=rows[:, -1],
        beyond=beyond / count,
        samples=np.array(float(count)),
    )
