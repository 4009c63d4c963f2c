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
from ._schedule import Schedule


@final
class CompressedRecording(eqx.Module):
    """What is left of a recording for the sake of its mean squared error.

    - `schedule`: with combinations of samples for samples.
    - `target`: the recorded temperatures combined alike, degC; `ones`: a constant 1 combined alike.
    - `beyond`: the mean square of what no temperatures around the steps could follow, K^2.
    - `samples`: how many there were.
    """

    schedule: Schedule
    target: Float[Array | np.ndarray, "rows channels"]
    ones: Float[Array | np.ndarray, " rows"]
    beyond: Float[Array | np.ndarray, " channels"]
    samples: int = eqx.field(static=True)


def compress(
    schedule: Schedule, recorded: Float[np.ndarray, "times channels"]
) -> CompressedRecording:
    """The recording of an experiment on its schedule, degC."""
    step_of, weights = np.asarray(schedule.step_of), np.asarray(schedule.weights)
    order = np.argsort(step_of, kind="stable")
    steps, first, counts = np.unique(step_of[order], return_index=True, return_counts=True)
    is_long = counts > POWERS
    short = order[~np.repeat(is_long, counts)]
    # The samples of each long step in a table of its own, filled up with nothing: one
    # factorisation of all, as a loop over steps would take longer than many a draw.
    place = np.arange(counts.max())
    filled = place < counts[is_long, None]
    sample = order[np.where(filled, first[is_long, None] + place, 0)]
    w, y, one = (
        np.where(filled[:, :, None], values[sample], 0.0)
        for values in (weights, recorded, np.ones((len(step_of), 1)))
    )
    q, r = np.linalg.qr(w)
    combined, ones = np.swapaxes(q, 1, 2) @ y, np.swapaxes(q, 1, 2) @ one
    beyond = np.sum((y - q @ combined) ** 2, axis=(0, 1))

    def rows(kept: np.ndarray, tables: np.ndarray) -> np.ndarray:
        return np.concatenate([kept[short], tables.reshape(-1, kept.shape[1])])

    return CompressedRecording(
        schedule=eqx.tree_at(
            lambda s: (s.step_of, s.weights),
            schedule,
            (
                np.concatenate([step_of[short], np.repeat(steps[is_long], POWERS)]),
                rows(weights, r),
            ),
        ),
        target=rows(recorded, combined),
        ones=rows(np.ones((len(step_of), 1)), ones)[:, 0],
        beyond=beyond / len(step_of),
        samples=len(step_of),
    )
