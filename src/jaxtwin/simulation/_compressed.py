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
    beyond = np.zeros(recorded.shape[1])
    steps, kept, targets, ones = [], [], [], []
    for step in np.unique(step_of):
        inside = step_of == step
        w, y, one = weights[inside], recorded[inside], np.ones(inside.sum())
        if len(w) > POWERS:
            q, w = np.linalg.qr(w)
            whole, y, one = y, q.T @ y, q.T @ one
            beyond += np.sum((whole - q @ y) ** 2, axis=0)
        steps += [step] * len(w)
        kept.append(w)
        targets.append(y)
        ones.append(one)
    combined = eqx.tree_at(
        lambda s: (s.step_of, s.weights),
        schedule,
        (np.array(steps, dtype=np.int32), np.concatenate(kept)),
    )
    return CompressedRecording(
        schedule=combined,
        target=np.concatenate(targets),
        ones=np.concatenate(ones),
        beyond=beyond / len(step_of),
        samples=len(step_of),
    )
