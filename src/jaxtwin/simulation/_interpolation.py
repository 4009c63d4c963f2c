"""Temperatures between the ends of steps: Hermite interpolation over a step and the one before."""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

Arrays = TypeVar("Arrays", np.ndarray, jax.Array)
"""Numbers known beforehand, or traced ones."""

POWERS = 6
"""Coefficients of a polynomial: as many as there are values and slopes."""


def step_polynomials(
    spans: Sequence[np.ndarray],
) -> Float[np.ndarray, "all_steps 6 6"]:
    """How much each value and slope around a step counts within it.

    A step of a span, during which inputs are held, has up to six: value and slope at its start, at
    its end, and at the start of the step before. The first step of a span has none before it. The
    slope at the end of a span is that under the inputs that follow, so that it does not count.

    **Arguments:**

    - `spans`: the steps of each span, `(steps,)`, s.

    **Returns:** coefficients (value at start, slope at start, value at end, slope at end, value
    before, slope before) x (powers of the part of the step that has gone by, 0 to 1); those of
    slopes in s.
    """
    rows = []
    last = len(spans) - 1
    for number, steps in enumerate(spans):
        for k, step in enumerate(steps):
            before = steps[k - 1] / step if k else None
            ends = k == len(steps) - 1 and number != last
            rows.append(_polynomials(before, not ends) * np.array([1, step] * 3)[:, None])
    return np.stack(rows)


def sample_weights(
    polynomials: Float[Arrays, "steps 6 6"],
    step_of: Int[Arrays, " times"],
    part: Float[Arrays, " times"],
) -> Float[Arrays, "times 6"]:
    """How much the values and slopes around its step count in each sample, `(times, 6)`.

    **Arguments:**

    - `polynomials`: of the steps, see `step_polynomials`.
    - `step_of`: in which step each sample lies, `(times,)`.
    - `part`: which part of that step has gone by, `(times,)`.
    """
    # Horner's rule: a product of tables would hold 36 numbers for each sample of each draw.
    weights: Any = polynomials[:, :, -1][step_of]
    for power in reversed(range(POWERS - 1)):
        weights = weights * part[:, None] + polynomials[:, :, power][step_of]
    return weights


def _polynomials(before: float | None, slope_at_end: bool) -> Float[np.ndarray, "6 6"]:
    """For a step of length 1, a step of length `before` behind it."""
    nodes = [(0, 0.0, 0), (1, 0.0, 1), (2, 1.0, 0)]
    nodes += [(3, 1.0, 1)] if slope_at_end else []
    nodes += [] if before is None else [(4, -before, 0), (5, -before, 1)]
    powers = np.arange(len(nodes))
    # Each row: what the powers contribute to one value or slope.
    rows = [
        at**powers if order == 0 else powers * at ** np.maximum(powers - 1, 0)
        for _, at, order in nodes
    ]
    found = np.zeros((6, POWERS))
    found[[place for place, *_ in nodes], : len(nodes)] = np.linalg.inv(np.stack(rows)).T
    return found
