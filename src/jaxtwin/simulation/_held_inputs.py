"""Inputs that are held between samples, during steps that contain several samples.

Within such a step, an input is taken as the quadratic that has the input's own means over each
third of the step. Both solvers integrate a quadratic exactly, and what it leaves out has a mean of
0 over each third: it moves no temperature by more than the largest integral of the rest, which the
time grid keeps small (`merged_changes`).
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int

# Changes of inputs across which steps go on: those of slow inputs, such as a room that drifts.
#
# A step that contains several changes takes the inputs as quadratics. What these leave out moves
# the channels by no more than its integral, times the rate at which they answer to the input.
# Runs of changes for which this is small are merged, in blocks of powers of two.


# The largest integral of what a step leaves out of its inputs, K.
ROUGHNESS = 5e-5


def merged_changes(
    times: Float[np.ndarray, " marks"],
    answers: Float[np.ndarray, "marks inputs"],
    stays: Bool[np.ndarray, " marks"],
    spread: float,
) -> Int[np.ndarray, " kept"]:
    """Chooses the changes of inputs at which a step must end.

    **Arguments:**

    - `times`: the times of the changes, with the start and the end of the run, s.
    - `answers`: the ambient temperature and the other inputs that are held from each of them on,
      each times the rate at which the channels answer to it, K/s. A step takes the ambient as a
      quadratic, and of the others the mean.
    - `stays`: whether a step must end at a change, whatever its size.
    - `spread`: the time by which steps may be late against these inputs, s.

    **Returns:** the positions of these changes, with the start and the end.
    """
    kept = np.ones(len(times), bool)
    if not answers.size or not np.ptp(answers, axis=0).any():
        return np.flatnonzero(kept)
    moved = answers - answers[0]
    integral = np.zeros_like(moved)
    integral[1:] = np.cumsum(moved[:-1] * np.diff(times)[:, None], axis=0)
    before = np.cumsum(stays)
    length = 2
    while length < len(times):
        count = np.cumsum(kept)
        first = np.arange(0, len(times) - length, length)
        last = first + length
        # Both halves are merged, and no change between them stays.
        inner = (before[last - 1] == before[first]) & (count[last - 1] - count[first] == 1)
        first, last = first[inner], last[inner]
        if not len(first):
            break
        smooth = _roughness(times, integral, first, last, spread) <= ROUGHNESS
        for start in first[smooth]:
            kept[start + 1 : start + length] = False
        if not smooth.any():
            break
        length *= 2
    return np.flatnonzero(kept)


def _roughness(
    times: Float[np.ndarray, " marks"],
    integral: Float[np.ndarray, "marks inputs"],
    first: Int[np.ndarray, " blocks"],
    last: Int[np.ndarray, " blocks"],
    spread: float,
) -> Float[np.ndarray, " blocks"]:
    """The largest integral of what quadratics or means leave out of the inputs of each block."""
    begin, end = times[first], np.minimum(times[last] + spread, times[-1])
    widest = int((np.searchsorted(times, end) - first).max())
    inside = np.minimum(first[:, None] + np.arange(widest + 1), len(times) - 1)
    total = np.zeros(len(first))
    x = np.minimum((_and_middles(times[inside]) - begin[:, None]) / (end - begin)[:, None], 1.0)
    for number, column in enumerate(integral.T):
        nodes = np.linspace(0.0, 1.0, 2 if number else 4)
        at = np.interp(begin[:, None] + nodes * (end - begin)[:, None], times, column)
        fitted = np.zeros_like(x)
        for place, node in enumerate(nodes):
            others = np.delete(nodes, place)
            weight = np.prod((x[..., None] - others) / (node - others), axis=-1)
            fitted += weight * at[:, place, None]
        rest = np.where(x < 1, np.abs(_and_middles(column[inside]) - fitted), 0.0)
        total += rest.max(axis=1)
    return total


def _and_middles(rows: Float[np.ndarray, "blocks marks"]) -> Float[np.ndarray, "blocks both"]:
    """Numbers, and those in the middle between two: an integral is a straight line there, from
    which a cubic differs most."""
    return np.concatenate([rows, (rows[:, 1:] + rows[:, :-1]) / 2], axis=1)


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
