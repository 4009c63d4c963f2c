"""Whether readings follow the duty at all."""

from typing import final

import numpy as np

from ..protocol._records import Reading
from ._duty_response import DutyResponse
from ._operating_limits import OperatingLimits

# The part of the predicted change by the duty below which a reading does not follow it. The
# recorded two-cell plate, one of whose cells is loose, shows at least 0.24 of what its twin
# predicts before a match, and the recorded single cell 0.85.
MIN_GAIN = 0.1

# The predicted change by the duty below which a reading is not judged, in limits of deviation: a
# contact that is worse than the twin's delays the first kelvins most.
MIN_CHANGE = 1.5

# The time constant with which earlier readings are forgotten, s of the rig. After a reversal of the
# duty the plate lags behind the twin, and a gain at one time says nothing.
MEMORY_SECONDS = 60.0

# The predicted change by the duty with which a reading is judged, in standard deviations of what is
# not known: its noise, the room and the start. A reading that stays where it was is then three of
# them from one that shows half of the change.
DEVIATIONS = 6.0


@final
class Responsiveness:
    r"""Estimates by least squares which part of the predicted change each reading shows.

    With $y$ the change of a reading beyond that of an idle rig, and $d$ the change by the duty
    that the twin predicts, the gain is $\sum w y d / \sum w d^2$ with weights $w$ that fade. What
    is not known, of standard deviation $\sigma$, changes it by $\sum w \sigma |d| / \sum w d^2$.

    **Arguments:**

    - `channels`: the number of channels.
    - `limits`: the limits of the rig.
    """

    def __init__(self, channels: int, limits: OperatingLimits):
        self._limits = limits
        self._sums = np.zeros((3, channels))  # of y d, sigma |d| and d^2
        self._last: int | None = None

    def judge(self, reading: Reading, response: DutyResponse) -> int | None:
        """Takes a reading. Returns the number of a channel that does not follow, if there is one.

        **Arguments:**

        - `reading`: valid temperatures.
        - `response`: the twins, up to this reading.
        """
        by_duty = response.by_duty
        shown = response.shown(reading.temperatures)
        deviations = response.deviations(self._limits.jump)
        passed = 0.0 if self._last is None else (reading.device_us - self._last) * 1e-6
        self._last = reading.device_us
        kept = np.exp(-max(passed, 0.0) / MEMORY_SECONDS)
        terms = shown * by_duty, deviations * np.abs(by_duty), by_duty**2
        self._sums = kept * self._sums + np.array(terms)
        followed, unknown, whole = self._sums
        large = np.abs(by_duty) >= MIN_CHANGE * self._limits.deviation
        judged = large & (DEVIATIONS * unknown <= whole)
        silent = judged & (followed < MIN_GAIN * whole)
        return int(np.argmax(silent)) if silent.any() else None
