"""The last minutes of a rig as a recording, for a diagnosis or a refit of now."""

from collections import deque
from typing import NamedTuple, final

import numpy as np

from ..errors import RecordingError
from ..io import Experiment
from ..live import Reading, Record, RigState, Sample, seconds
from ..physics import Twin

# The time between two samples that are kept, s of the rig.
SPACING_SECONDS = 1.0

# How much earlier than that a reading may be, s, so that one in time is not taken for early.
TIME_TOLERANCE_SECONDS = 0.01

# A change of the duty by more than this gets a row of its own, without readings: the heat is not
# linear in the duty, and the mean of 0.5 and -0.3 in a row would lose half of the Joule heat.
MAX_AVERAGED_CHANGE = 0.1

# The number of rows with readings that are kept, and of all rows.
MAX_SAMPLES = 1500
MAX_ROWS = 2 * MAX_SAMPLES


class _SampleRow(NamedTuple):
    """A sample: time, s of the rig; temperatures and ambient temperature, degC; duty; and whether
    it is a reading, or a change of the duty alone."""

    time: float
    duty: np.ndarray
    temperatures: np.ndarray
    ambient: float
    is_reading: bool


@final
class RecentSamples:
    """Keeps the last samples. It consumes the records of a source.

    **Arguments:**

    - `twin`: the twin of the rig.
    """

    def __init__(self, twin: Twin):
        self._twin = twin
        self._rows: deque[_SampleRow] = deque()
        self._readings = 0  # in the rows
        self._last: tuple[int, float] | None = None  # host time, ns, and that of the rig, s
        self._origin = 0.0
        self._rate = 1.0
        # The duty now, since when it is summed up, and its integral since the last row before that.
        self._duty = np.zeros(len(twin.rig.driven))
        self._since, self._sum = 0.0, np.zeros(len(twin.rig.driven))
        self._heard = 0.0  # the time of the last sample, s of the rig
        self._read = 0.0  # the time of the last row with readings, s of the rig

    @property
    def now(self) -> float:
        """The time of the last sample since the first record, s of the rig."""
        return self._rows[-1].time if self._rows else 0.0

    def __len__(self) -> int:
        """The number of readings."""
        return self._readings

    def on_record(self, record: Record, state: RigState) -> None:
        """Keeps readings, one in each second of the rig, with the mean duty until the next row. A
        duty that came between two readings counts from then on, and begins a row if it differs
        much."""
        ambient = np.nan if state.ambient is None else state.ambient
        if isinstance(record, Sample) and record.pwm:
            duty = np.asarray(self._twin.rig.driver.duty(record.pwm), float)
            if self._rows:
                now = self._rig_time(state.time_of(record), state.rate)
                # A new duty came at some time since the sample before: in the middle, on average.
                change = float(np.abs(duty - self._duty).max())
                changed = (self._heard + now) / 2 if change > 0 else now
                self._sum_until(changed)
                self._heard = now
                if change > MAX_AVERAGED_CHANGE and changed > self._rows[-1].time:
                    self._end_row(changed)
                    unread = np.full(len(self._twin.channels), np.nan)
                    self._append(_SampleRow(changed, duty, unread, ambient, is_reading=False))
            self._duty = duty
        if not isinstance(record, Reading) or record.recalibrating or state.sample is None:
            return
        at = state.time_of(record)
        if self._last is None:
            self._origin, self._last = seconds(at), (at, 0.0)
        elapsed = self._rig_time(at, state.rate)
        self._last, self._rate = (max(at, self._last[0]), elapsed), state.rate
        if self._rows:
            is_early = elapsed - self._read < SPACING_SECONDS - TIME_TOLERANCE_SECONDS
            if is_early or elapsed <= self._rows[-1].time:
                return
            self._sum_until(elapsed)
            self._end_row(elapsed)
        self._append(_SampleRow(elapsed, self._duty, record.temperatures, ambient, is_reading=True))
        self._since = self._read = elapsed

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: samples come with readings."""

    def host_time(self, time: float) -> float:
        """The time of the host, s since 1970, at a time of the rig."""
        return self._origin + time / self._rate

    def recorded(self, length: float | None = None) -> Experiment:
        """The last `length` seconds of the rig as a recording; None: all that is kept.

        **Raises:** `RecordingError` if there are fewer than two samples.
        """
        rows = [row for row in self._rows if length is None or row.time >= self.now - length]
        if len(rows) < 2:
            raise RecordingError("the last minutes: expected readings and duty, got none yet")
        ambient = np.array([row.ambient for row in rows])
        return Experiment(
            [row.time for row in rows],
            [row.duty for row in rows],
            cells=self._twin.rig.driven,
            channels=self._twin.channels,
            temperatures=[row.temperatures for row in rows],
            ambient=ambient if np.isfinite(ambient).any() else None,
            inputs=self._twin.rig.usual_inputs,
            name=f"live at {self.now:.0f} s",
        )

    def _append(self, row: _SampleRow) -> None:
        """Appends a row, and forgets the first ones."""
        self._rows.append(row)
        self._readings += row.is_reading
        while self._readings > MAX_SAMPLES or len(self._rows) > MAX_ROWS:
            self._readings -= self._rows.popleft().is_reading

    def _end_row(self, time: float) -> None:
        """Gives the last row the mean duty until a time of the rig, to which it was summed up."""
        last = self._rows[-1]
        self._rows[-1] = last._replace(duty=self._sum / (time - last.time))
        self._sum = np.zeros_like(self._duty)

    def _sum_until(self, time: float) -> None:
        """Sums the present duty up until a time of the rig."""
        passed = max(time - self._since, 0.0)
        self._sum, self._since = self._sum + passed * self._duty, self._since + passed

    def _rig_time(self, at: int, rate: float) -> float:
        """The time of the rig at a host time that is not before the last reading."""
        assert self._last is not None
        before, elapsed = self._last
        return elapsed + max(seconds(at - before), 0.0) * rate
