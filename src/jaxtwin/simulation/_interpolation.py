"""Hermite interpolation of temperatures within a step, from this step and the previous one."""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

# NumPy numbers, or numbers that JAX traces.
Arrays = TypeVar("Arrays", np.ndarray, jax.Array)

# The number of coefficients of a polynomial, which is the number of values and slopes.
POWERS = 6

# The row of a step's polynomials that belongs to the slope at its end.
SLOPE_AT_END = 3

# The polynomials of a step of no length: the value at its start.
CONSTANT_POLYNOMIALS = np.diag([1.0, *[0.0] * (POWERS - 1)])


def step_polynomials(
    spans: Sequence[np.ndarray],
) -> Float[np.ndarray, "all_steps 6 6"]:
    """The weights of the values and slopes around a step, as polynomials of the time within it.

    A span is a time during which the inputs are held. A step of a span has up to six values and
    slopes: those at its start, at its end, and at the start of the previous step. The first step of
    a span has no previous step. The slope at the end of a span has no weight, because it is that
    under the following inputs. A step of no length at the end of a span gives the step before it a
    slope under its own inputs.

    **Arguments:**

    - `spans`: the step sizes of each span, `(steps,)`, s.

    **Returns:** coefficients (value at start, slope at start, value at end, slope at end, previous
    value, previous slope) x (powers of the elapsed fraction of the step, 0 to 1). The coefficients
    of slopes are in s.
    """
    rows = []
    last = len(spans) - 1
    for number, steps in enumerate(spans):
        for k, step in enumerate(steps):
            if step == 0:
                rows.append(CONSTANT_POLYNOMIALS)
                continue
            before = steps[k - 1] / step if k else None
            ends = k == len(steps) - 1 and number != last
            rows.append(_polynomials(before, not ends) * np.array([1, step] * 3)[:, None])
    return np.stack(rows)


def sample_weights(
    polynomials: Float[Arrays, "steps 6 6"],
    step_of: Int[Arrays, " times"],
    part: Float[Arrays, " times"],
) -> Float[Arrays, "times 6"]:
    """The weights of the values and slopes around its step in each sample, `(times, 6)`.

    **Arguments:**

    - `polynomials`: the polynomials of the steps, see `step_polynomials`.
    - `step_of`: the index of the step that contains each sample, `(times,)`.
    - `part`: the elapsed fraction of that step at each sample, `(times,)`.
    """
    # Horner's rule: a product of tables would hold 36 numbers for each sample of each draw.
    weights: Any = polynomials[:, :, -1][step_of]
    for power in reversed(range(POWERS - 1)):
        weights = weights * part[:, None] + polynomials[:, :, power][step_of]
    return weights


def _polynomials(before: float | None, slope_at_end: bool) -> Float[np.ndarray, "6 6"]:
    """The polynomials for a step of length 1 that follows a step of length `before`."""
    nodes = [(0, 0.0, 0), (1, 0.0, 1), (2, 1.0, 0)]
    nodes += [(3, 1.0, 1)] if slope_at_end else []
    nodes += [] if before is None else [(4, -before, 0), (5, -before, 1)]
    powers = np.arange(len(nodes))
    # Each row contains the contributions of the powers to a value or a slope.
    rows = [
        at**powers if order == 0 else powers * at ** np.maximum(powers - 1, 0)
        for _, at, order in nodes
    ]
    result = np.zeros((6, POWERS))
    result[[place for place, *_ in nodes], : len(nodes)] = np.linalg.inv(np.stack(rows)).T
    return result
