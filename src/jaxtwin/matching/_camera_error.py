r"""The camera's error that all channels share, as a sum of known shapes with unknown amplitudes.

$$c(t) = b_0 + \text{drift}(t) + \sum_{kj} b_{kj} e^{-(t - t_k) / \tau_j} \,[t \ge t_k]$$

The shapes are a constant, a piecewise linear function with equidistant corners for the slow drift,
and for each flat-field correction $t_k$ steps that decay. There is no step that stays: a correction
returns the camera to its true level, and a sum of lasting steps could imitate a plate that warms
up. The amplitudes $b$ enter the readings linearly. The match therefore solves for them in closed
form (variable projection, Golub and Pereyra 2003), and the optimiser does not see them. Each
amplitude has a prior standard deviation; without it the shapes could imitate the plate.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ..io import Experiment
from ..physics import Twin
from ..rig import CommonError
from ..simulation import Initial, Run, simulate

# The number of shapes is a multiple of this; the rest are zeros. Corrections that are found between
# two rounds of a match then need no new compilation.
SHAPE_BLOCK = 64


def count_shapes(
    error: CommonError, time: Float[np.ndarray, " times"], events: tuple[float, ...]
) -> int:
    """The number of shapes of a recording, including those of zeros that fill a block."""
    count = 1 + len(_corners(error, time)) + len(events) * len(error.relaxation)
    return -(-count // SHAPE_BLOCK) * SHAPE_BLOCK


def camera_shapes(
    error: CommonError, time: Float[np.ndarray, " times"], events: tuple[float, ...], count: int
) -> tuple[Float[np.ndarray, "times shapes"], Float[np.ndarray, " shapes"]]:
    """The shapes of one recording, and the prior standard deviation of each amplitude, K.

    **Arguments:**

    - `error`: the priors of the rig file.
    - `time`: times of the samples, s.
    - `events`: times of the corrections, s. A jump appears from the first sample at or after its
      time.
    - `count`: the number of shapes, at least `count_shapes`; the others are zeros.
    """
    shapes, standard_deviations = [np.ones_like(time)], [error.offset]
    corners = _corners(error, time)
    for number in range(len(corners)):
        shapes.append(np.interp(time, corners, np.eye(len(corners))[number]))
        standard_deviations.append(error.drift)
    for event in events:
        after = time >= event
        elapsed = np.where(after, time - event, 0.0)
        shapes += [after * np.exp(-elapsed / tau) for tau in error.relaxation]
        standard_deviations += [error.jump] * len(error.relaxation)
    empty = count - len(shapes)
    shapes += [np.zeros_like(time)] * empty
    standard_deviations += [1.0] * empty
    return np.stack(shapes, axis=1), np.array(standard_deviations)


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
    """Detects flat-field corrections: jumps between two samples that all channels share.

    The jump at a sample is the difference between a line through the ten seconds before it and a
    line through the ten seconds after it. The plate and the drift are smooth on this scale. A jump
    counts if it exceeds `JUMP_SIGMAS` robust standard deviations of all such differences and is the
    largest within `FIT_WINDOW_SECONDS` on either side.

    Cameras correct themselves at equal intervals. If there are three such jumps or more, and all
    fit one interval, the threshold at the other expected times is `FAINT_JUMP_SIGMAS` standard
    deviations.

    **Arguments:**

    - `time`: times of the samples, s.
    - `common_mode`: mean over the channels of recorded minus simulated temperatures, K.
    - `counted`: the times that have samples. Other values are interpolated, and a jump beside such
      times counts only if at least half of the seconds of each line have samples.
    """
    sample = float(np.median(np.diff(time)))
    width = max(4, round(FIT_WINDOW_SECONDS / sample))
    if len(time) < 4 * width:
        return ()
    line = np.stack([np.ones(width), np.arange(width) + 0.5], axis=1)
    end = np.linalg.pinv(line)[0]
    windows = np.lib.stride_tricks.sliding_window_view(common_mode, width)
    jumps = np.abs(windows[width:] @ end - windows[:-width] @ end[::-1])
    at = time[width : width + len(jumps)]
    there = np.lib.stride_tricks.sliding_window_view(counted, width).mean(axis=1) >= 0.5
    complete = there[width:] & there[:-width]
    if not complete.any():
        return ()
    noise = 1.4826 * np.median(jumps[complete])
    jumps = np.where(complete, jumps, 0.0)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(jumps, width), 2 * width + 1)
    clear = at[(jumps > JUMP_SIGMAS * noise) & (jumps == nearby.max(axis=1))]
    events = set(clear.tolist())
    for expected in _at_equal_intervals(clear, float(time[0]), float(time[-1])):
        near = np.abs(at - expected) <= MAX_TIMING_ERROR_SECONDS
        if near.any() and not np.any(np.abs(clear - expected) <= MAX_TIMING_ERROR_SECONDS):
            largest = int(np.argmax(np.where(near, jumps, -1.0)))
            if jumps[largest] > FAINT_JUMP_SIGMAS * noise:
                events.add(float(at[largest]))
    return tuple(sorted(events))


def _at_equal_intervals(
    clear: Float[np.ndarray, " jumps"], start: float, end: float
) -> Float[np.ndarray, " expected"]:
    """Times at which corrections are expected, if the clear ones come at equal intervals; otherwise
    none."""
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
                if (
                    interval > max(MIN_INTERVAL_SECONDS, longest)
                    and off <= MAX_TIMING_ERROR_SECONDS
                ):
                    longest = interval
                    fit = np.polynomial.Polynomial.fit(count, clear, 1).convert()
                    zero, slope = fit.coef
                    numbers = np.arange(
                        np.ceil((start - zero) / slope), np.floor((end - zero) / slope) + 1
                    )
                    best = zero + slope * numbers
    return best


# A jump above this many robust standard deviations is a correction.
JUMP_SIGMAS = 4.0

# A jump above this many robust standard deviations is a correction at a time at which one is
# expected.
FAINT_JUMP_SIGMAS = 1.5

# The largest distance of a correction from its expected time, s.
MAX_TIMING_ERROR_SECONDS = 5.0

# The shortest time between two corrections, s.
MIN_INTERVAL_SECONDS = 60.0

# The length of the lines that are fitted on both sides of a jump, s.
FIT_WINDOW_SECONDS = 10.0


@final
@dataclass(frozen=True, eq=False)
class CameraError:
    """The camera's error that all channels of a recording share.

    - `events`: times of its flat-field corrections, s.
    - `error`: the part of simulated minus recorded temperature that is the camera's, `(times,)`, K.
    """

    events: tuple[float, ...]
    error: Float[np.ndarray, " times"]

    @property
    def offset(self) -> Float[np.ndarray, " times"]:
        """The amount by which the camera reads too warm, K."""
        return -self.error


@final
@dataclass(frozen=True, eq=False)
class Comparison:
    """The fitted twin compared with a recording.

    - `twin`: the twin with the values of the recording. `experiment`: the recording.
    - `initial`: the temperatures at the start, as `simulate` takes them.
    - `camera`: the camera's common error.
    """

    twin: Twin
    experiment: Experiment
    initial: Initial
    camera: CameraError

    @cached_property
    def run(self) -> Run:
        """The run of the fitted twin, without the camera's common error. The first access
        simulates it."""
        return simulate(self.twin, self.experiment, initial=self.initial)

    @property
    def reading(self) -> Run:
        """The run with the camera's common error added to its temperatures."""
        return replace(self.run, temperatures=self.run.temperatures + self.camera.offset[:, None])
