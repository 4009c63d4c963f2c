"""Inputs that are held between samples, during steps that contain several samples.

Within such a step, an input is taken as the quadratic that has the input's own means over each
third of the step. Both solvers integrate a quadratic exactly, and what it leaves out has a mean of
0 over each third: it moves no temperature by more than the largest integral of the rest, which the
time grid keeps small (`_merged_changes`).
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

# Sums of step sizes and times of samples differ by less than this, s.
ROUNDING = 1e-7


def held_quadratics(
    times: Float[Array | np.ndarray, " times"],
    held: Float[Array | np.ndarray, " times"],
    sizes: Float[Array | np.ndarray, " steps"],
    xp: Any = np,
) -> Float[Any, "steps 3"]:
    """An input at the start, in the middle and at the end of each step.

    **Arguments:**

    - `times`: the times of the samples, from 0 on, s.
    - `held`: the input from each sample on. The last sample is held for ever.
    - `sizes`: the step sizes, s. A step of no length has the input of the step before it.
    - `xp`: `numpy`, or `jax.numpy` for numbers that JAX traces.
    """
    ends = xp.cumsum(sizes)
    starts = ends - sizes
    later = xp.maximum(ends[-1], times[-1]) + 1.0
    edges = xp.concatenate([times, later[None]])
    # Differences from the first sample, whose integral keeps more digits.
    moved = held - held[0]
    integral = xp.concatenate([xp.zeros_like(moved[:1]), xp.cumsum(moved * xp.diff(edges))])
    thirds = starts[:, None] + sizes[:, None] * xp.linspace(0.0, 1.0, 4)
    lengths = xp.where(sizes > 0, sizes, 1.0)[:, None] / 3
    means = xp.diff(xp.interp(thirds, edges, integral), axis=1) / lengths
    a, b, c = means.T
    quadratic = xp.stack(
        [
            (11 * a - 7 * b + 2 * c) / 6,
            b - (a - 2 * b + c) / 24,
            (2 * a - 7 * b + 11 * c) / 6,
        ],
        axis=1,
    )
    # Steps between two samples have the input itself, without the rounding of the integral.
    first = xp.searchsorted(times, starts + ROUNDING, side="right") - 1
    last = xp.maximum(xp.searchsorted(times, ends - ROUNDING) - 1, 0)
    is_held = (first >= last)[:, None]
    values = held[0] + xp.where(is_held, moved[last][:, None], quadratic)
    before = xp.maximum.accumulate(xp.where(sizes > 0, xp.arange(len(sizes)), 0))
    return xp.where((sizes > 0)[:, None], values, values[before, 2:])


def quadratic_at(
    values: Float[np.ndarray, "*steps 3"], parts: Float[np.ndarray, "*steps stages"]
) -> Float[np.ndarray, "*steps stages"]:
    """Quadratics of given values at the start, in the middle and at the end of steps, after some
    parts of these, 0 to 1."""
    start, middle, end = np.moveaxis(values, -1, 0)[..., None]
    slope, bend = 4 * (middle - start) - (end - start), 2 * (end - start) - 4 * (middle - start)
    return start + parts * (slope + parts * bend)


def mean_of(values: Float[Any, "steps 3"]) -> Float[Any, " steps"]:
    """The means of quadratics over their steps."""
    # What is held during a step is itself its mean, without a rounding error.
    return values[:, 0] + (values - values[:, :1]) @ np.array([0, 4, 1]) / 6
