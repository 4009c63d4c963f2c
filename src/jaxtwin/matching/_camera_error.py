r"""What a camera adds to all channels alike, as a sum of known shapes of unknown size.

$$c(t) = b_0 + \text{drift}(t) + \sum_{kj} b_{kj} e^{-(t - t_k) / \tau_j} \,[t \ge t_k]$$

A constant, a line with corners at equal distances for the slow drift, and for every flat-field
correction $t_k$ steps that fade. A step that stays is not among them: a correction takes the camera
back to where it should be, and a sum of lasting steps could imitate a plate that warms up.
The sizes $b$ enter the readings linearly, so that matching can solve for them in closed form
(variable projection, Golub and Pereyra 2003) and the optimiser never sees them. Each has a
standard deviation beforehand, without which they could imitate the plate.
"""

import numpy as np
from jaxtyping import Bool, Float

from ..rig import CommonError

BLOCK = 64
"""Shapes are counted in blocks of this many, filled with zeros, so that corrections found between
two rounds of a match mean no compilation anew."""


def count_shapes(
    error: CommonError, time: Float[np.ndarray, " times"], events: tuple[float, ...]
) -> int:
    """How many shapes a recording has, those of zeros that fill a block among them."""
    count = 1 + len(_corners(error, time)) + len(events) * len(error.relaxation)
    return -(-count // BLOCK) * BLOCK


def camera_shapes(
    error: CommonError, time: Float[np.ndarray, " times"], events: tuple[float, ...], count: int
) -> tuple[Float[np.ndarray, "times shapes"], Float[np.ndarray, " shapes"]]:
    """The shapes of one recording and the standard deviation of the size of each, K.

    **Arguments:**

    - `error`: what is known beforehand.
    - `time`: of the samples, s.
    - `events`: times of the corrections, s; a jump shows from the first sample at or after it.
    - `count`: of shapes, `count_shapes` at least; the others are zeros.
    """
    shapes, spreads = [np.ones_like(time)], [error.offset]
    corners = _corners(error, time)
    for number in range(len(corners)):
        shapes.append(np.interp(time, corners, np.eye(len(corners))[number]))
        spreads.append(error.drift)
    for event in events:
        after = time >= event
        elapsed = np.where(after, time - event, 0.0)
        shapes += [after * np.exp(-elapsed / tau) for tau in error.relaxation]
        spreads += [error.jump] * len(error.relaxation)
    empty = count - len(shapes)
    shapes += [np.zeros_like(time)] * empty
    spreads += [1.0] * empty
    return np.stack(shapes, axis=1), np.array(spreads)


def _corners(
    error: CommonError, time: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " corners"]:
    """Times of the corners of the drift, s."""
    spans = np.ceil((time[-1] - time[0]) / error.drift_time)
    return time[0] + error.drift_time * np.arange(spans + 1)


def detect_events(
    time: Float[np.ndarray, " times"],
    common_mode: Float[np.ndarray, " times"],
    counted: Bool[np.ndarray, " times"],
) -> tuple[float, ...]:
    """Times of flat-field corrections: jumps within a sample that all channels share.

    The jump at a sample is what lies between a line through the ten seconds before it and one
    through the ten seconds after it. What the plate does is smooth at that scale, and so is drift.
    Jumps count that exceed `CLEAR` robust standard deviations of all such differences and are the
    largest within `WINDOW` on either side.

    Cameras correct themselves at equal intervals. Where three or more jumps fit such intervals, the
    corrections between, before and after them count from `FAINT` standard deviations on.

    **Arguments:**

    - `time`: s.
    - `common_mode`: mean over the channels of recorded less simulated temperatures, K.
    - `counted`: where there is one. Elsewhere it lies between its neighbours, and a jump beside
      such times counts where at least half of each line's seconds are there.
    """
    sample = float(np.median(np.diff(time)))
    width = max(4, round(WINDOW / sample))
    if len(time) < 4 * width:
        return ()
    line = np.stack([np.ones(width), np.arange(width) + 0.5], axis=1)
    end = np.linalg.pinv(line)[0]
    windows = np.lib.stride_tricks.sliding_window_view(common_mode, width)
    jumps = np.abs(windows[width:] @ end - windows[:-width] @ end[::-1])
    at = time[width : width + len(jumps)]
    there = np.lib.stride_tricks.sliding_window_view(counted, width).mean(axis=1) >= 0.5
    told = there[width:] & there[:-width]
    if not told.any():
        return ()
    noise = 1.4826 * np.median(jumps[told])
    jumps = np.where(told, jumps, 0.0)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(jumps, width), 2 * width + 1)
    clear = at[(jumps > CLEAR * noise) & (jumps == nearby.max(axis=1))]
    events = set(clear.tolist())
    for expected in _at_equal_intervals(clear, float(time[0]), float(time[-1])):
        near = np.abs(at - expected) <= NEAR
        if near.any() and not np.any(np.abs(clear - expected) <= NEAR):
            largest = int(np.argmax(np.where(near, jumps, -1.0)))
            if jumps[largest] > FAINT * noise:
                events.add(float(at[largest]))
    return tuple(sorted(events))


def _at_equal_intervals(
    clear: Float[np.ndarray, " jumps"], start: float, end: float
) -> Float[np.ndarray, " expected"]:
    """When corrections are expected if the clear ones come at equal intervals; none otherwise."""
    best: Float[np.ndarray, " expected"] = np.zeros(0)
    if len(clear) < 3:
        return best
    longest = 0.0
    for first in range(len(clear)):
        for second in range(first + 1, len(clear)):
            for parts in range(1, 7):
                interval = (clear[second] - clear[first]) / parts
                count = np.round((clear - clear[first]) / interval)
                off = np.abs(clear - clear[first] - count * interval).max()
                if interval > max(SHORTEST, longest) and off <= NEAR:
                    longest = interval
                    fit = np.polynomial.Polynomial.fit(count, clear, 1).convert()
                    zero, slope = fit.coef
                    numbers = np.arange(
                        np.ceil((start - zero) / slope), np.floor((end - zero) / slope) + 1
                    )
                    best = zero + slope * numbers
    return best


CLEAR = 4.0
"""A jump is one above this many robust standard deviations."""

FAINT = 1.5
"""A jump is one above as many where one is expected."""

NEAR = 5.0
"""How far from where it is expected a correction may be, s."""

SHORTEST = 60.0
"""Time between two corrections at least, s."""

WINDOW = 10.0
"""Of the lines on both sides of a jump, s."""
