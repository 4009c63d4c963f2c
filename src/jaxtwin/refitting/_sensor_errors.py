r"""Errors that all sensors of a rig share, and how large they would have to be.

A wrong gain of all readings looks like another supply, a clock that is fast like smaller heat
capacities, and an offset like another room. Each is a rival of a change of the rig, as other
mistakes of a recording are (`_mistakes`): the recording without it is matched from the same prior.
Its size $s$ has a prior as the value of a parameter has one, and is estimated by the minimum of the
cost $C(s) + s^2 / 2 \sigma^2$.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ..io import Experiment

# The number of steps to either side of no error within which its size is sought.
MAX_STEPS = 4


@final
@dataclass(frozen=True)
class SensorError:
    """An error of all sensors.

    - `corrected`: a recording, its room in degC, and a size -> the recording without the error.
    - `spread`: the standard deviation of its size. `step`: the distance of sizes that are tried.
    - `sentence`: the size, and whether the room is recorded -> what would be wrong, as the end of a
      sentence.
    - `gain`, `clock`: the size -> the factor by which readings, and the recorded time, are too
      large.
    """

    corrected: Callable[[Experiment, float, float], Experiment]
    spread: float
    step: float
    sentence: Callable[[float, bool], str]
    gain: Callable[[float], float] = lambda size: 1.0
    clock: Callable[[float], float] = lambda size: 1.0


def _without_gain(recording: Experiment, room: float, size: float) -> Experiment:
    """Readings whose rise above the room is divided by the gain, whose logarithm is the size."""
    away = np.broadcast_to(room if recording.ambient is None else recording.ambient,
                           recording.time.shape)[:, None]  # fmt: skip
    readings = np.asarray(recording.temperatures)
    return replace(recording, temperatures=away + (readings - away) * math.exp(-size))


def _without_offset(recording: Experiment, room: float, size: float) -> Experiment:
    return replace(recording, temperatures=np.asarray(recording.temperatures) - size)


def _without_clock(recording: Experiment, room: float, size: float) -> Experiment:
    """A recording whose clock ran at the right rate. It began at the right time."""
    begin = recording.time[0]
    return replace(recording, time=begin + (recording.time - begin) * math.exp(-size))


def _offset_sentence(size: float, has_room: bool) -> str:
    high, low = ("high", "low") if size > 0 else ("low", "high")
    room = f", or its room too {low}" if has_room else ""
    return f"if all its readings were {abs(size):.2g} K too {high}{room}"


# The errors that are tried. Gains and rates of clocks are logarithms: those of sensors and counters
# that were set up wrongly, rather than what their makers state.
SENSOR_ERRORS = (
    SensorError(
        _without_gain,
        spread=0.1,
        step=0.06,
        sentence=lambda size, _: (
            f"if all its readings showed {math.exp(size):.2f} times their rise above the room"
        ),
        gain=math.exp,
    ),
    SensorError(_without_offset, spread=3.0, step=1.5, sentence=_offset_sentence),
    SensorError(
        _without_clock,
        spread=0.1,
        step=0.05,
        sentence=lambda size, _: f"if its clock ran {math.exp(size):.2f} times as fast",
        clock=math.exp,
    ),
)


def smallest(
    costs_of: Callable[[Sequence[float]], list[float]], error: SensorError, without: float
) -> tuple[float, float]:
    """The size of an error at which the cost with its prior is smallest, and that cost.

    The sizes next to none are tried, and further ones as long as the last of them is the best; then
    the minimum of the parabola through the best three.

    **Arguments:**

    - `costs_of`: sizes -> the costs without their prior.
    - `without`: the cost of no error.
    """
    known = {0: without}

    def add(places: Sequence[int]) -> None:
        result = costs_of([place * error.step for place in places])
        for place, cost in zip(places, result, strict=True):
            known[place] = cost + (place * error.step / error.spread) ** 2 / 2

    add((-1, 1))
    best = min(known, key=known.__getitem__)
    while best != 0 and abs(best) < MAX_STEPS and best + int(np.sign(best)) not in known:
        add((best + int(np.sign(best)),))
        best = min(known, key=known.__getitem__)
    size, cost = best * error.step, known[best]
    left, right = known.get(best - 1, math.inf), known.get(best + 1, math.inf)
    curvature, slope = left - 2 * cost + right, (right - left) / 2
    if not (math.isfinite(curvature) and curvature > 0):
        return size, cost
    middle = size - error.step * slope / curvature
    (exact,) = costs_of([middle])
    exact += (middle / error.spread) ** 2 / 2
    return (middle, exact) if exact < cost else (size, cost)
