"""The samples of a rig that wait to be used: checked, in their order, and limited in number."""

import json
import math
from collections import Counter, deque
from typing import Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..live import seconds
from ..rig import Rig

# The samples that wait at most; then the oldest are passed over.
MAX_WAITING = 600

# The longest time without a sample over which a rig is predicted, s; afterwards its observer
# begins again.
MAX_GAP = 300.0

# A reading that is older than the last one by less than this came twice or late, s; otherwise the
# clock of the rig was set back.
MAX_LATE = 60.0

# Readings outside of this range are no temperatures, degC.
LOWEST, HIGHEST = -273.15, 5000.0

# The latest time that a message may state, s since 1970.
LATEST = 2e10

Kind = Literal["readings", "duty"]


class QueuedSample(NamedTuple):
    """A message of a rig.

    - `time`: when it was made, ns since 1970.
    - `readings`: degC, NaN for a channel without one; None for a message of the duty.
    - `duty`: -1 to 1; None for readings. `ambient`: degC, NaN if it is not stated.
    - `number`: that of the journal.
    """

    time: int
    readings: Float[np.ndarray, " channels"] | None
    duty: Float[np.ndarray, " cells"] | None
    ambient: float
    number: int


class ObserverStep(NamedTuple):
    """A step of an observer.

    - `dt`: its length, s. `elapsed`: the time since the reading before, s.
    - `readings`: those at its end; None: there are none.
    - `begins`: whether the observer begins with these readings.
    """

    dt: float
    elapsed: float
    duty: Float[np.ndarray, " cells"]
    ambient: float
    readings: Float[np.ndarray, " channels"] | None
    begins: bool = False


@final
class SampleQueue:
    """Takes the messages of a rig, and gives the steps of its observer, as `Follower` takes them.

    **Arguments:**

    - `rig`: the rig. `sample_time`: the time between two readings that are used, s.
    - `longest_step`: the longest step of the observer, s.
    """

    def __init__(self, rig: Rig, sample_time: float, longest_step: float):
        self.counts: Counter[str] = Counter()
        """How many readings were `used`, and how messages were bad."""
        self.number = 0
        """The number in the journal of the last message that was used."""
        self.time = 0
        """The time up to which the rig is followed, ns."""
        self._rig, self._sample_time, self._longest = rig, sample_time, longest_step
        self._channels = tuple(channel.name for channel in rig.channels)
        self._waiting: deque[QueuedSample] = deque()
        self._last: int | None = None  # the time of the last reading that was taken
        self._read: int | None = None  # that of the last one that was used
        self._duty, self._ambient = np.zeros(len(rig.driven)), math.nan
        self._stated: tuple[float, ...] = ()  # duty and ambient temperature that were taken last
        self._parts = self._done = 0  # of the gap before the first sample that waits

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def duty(self) -> Float[np.ndarray, " cells"]:
        """The duty that was applied last, -1 to 1."""
        return self._duty

    @property
    def ambient(self) -> float:
        """The ambient temperature that was stated last, degC; NaN if none was."""
        return self._ambient

    def put(self, kind: Kind, payload: bytes, number: int) -> None:
        """Takes a message. One that is malformed, late or sooner than needed is counted."""
        sample = self.parsed(kind, payload, number)
        if sample is None:
            self.counts["malformed"] += 1
            return
        if sample.readings is not None:
            last = self._last
            if last is not None and sample.time <= last:
                if seconds(last - sample.time) < MAX_LATE:
                    self.counts["late"] += 1
                    return
                self.counts["clock_set_back"] += 1
            elif last is not None and seconds(sample.time - last) < 0.5 * self._sample_time:
                self.counts["thinned"] += 1
                return
            self._last = sample.time
        elif sample.duty is not None:
            stated = (*sample.duty.tolist(), sample.ambient)
            if stated == self._stated:  # a device may repeat it ten times a second
                self.counts["thinned"] += 1
                return
            self._stated = stated
        self._waiting.append(sample)
        if len(self._waiting) > MAX_WAITING:
            self.counts["overflow"] += 1
            self._parts = self._done = 0
            oldest = self._waiting.popleft()
            if oldest.duty is not None:
                self._apply(oldest, oldest.duty)

    def next(self) -> ObserverStep | None:
        """The next step of the observer; None: there is no sample."""
        while self._waiting:
            sample = self._waiting[0]
            gap = seconds(sample.time - self.time)
            if self._read is not None and not -MAX_LATE < gap <= MAX_GAP:
                self.counts["gap"] += 1
                self.restart()
            if sample.duty is not None:
                # A duty that is not new is left to the reading that follows it.
                if self._read is None or not (sample.duty != self._duty).any():
                    self._take()
                    self._apply(sample, sample.duty)
                    continue
            elif self._read is None:
                self._take()
                self.time = self._read = sample.time
                return ObserverStep(
                    0.0, 0.0, self._duty, self._ambient, sample.readings, begins=True
                )
            gap = max(gap, 0.0)
            if not self._parts:
                self._parts = max(math.ceil(gap / self._longest - 1e-9), 1)
            self._done += 1
            step = ObserverStep(gap / self._parts, 0.0, self._duty, self._ambient, None)
            if self._done < self._parts:
                return step
            self._take()
            self.time = max(sample.time, self.time)
            if sample.duty is not None:
                self._apply(sample, sample.duty)
                return step
            assert self._read is not None
            elapsed = max(seconds(sample.time - self._read), 0.0)
            self._read = max(sample.time, self._read)
            return step._replace(elapsed=elapsed, readings=sample.readings)
        return None

    def restart(self) -> None:
        """Begins again with the next reading."""
        self._read, self._parts, self._done = None, 0, 0

    def to_dict(self) -> dict[str, Any]:
        """What was used, as a dictionary that JSON can hold, from which `resume` goes on."""
        ambient = None if math.isnan(self._ambient) else self._ambient
        state = {name: getattr(self, name) for name in ("number", "time", "_read")}
        return {**state, "duty": self._duty.tolist(), "ambient": ambient,
                "counts": dict(self.counts)}  # fmt: skip

    def resume(self, content: dict[str, Any]) -> None:
        """Goes on from what `to_dict` gave."""
        for name in ("number", "time", "_read"):
            setattr(self, name, content[name])
        self._duty = np.array(content["duty"])
        self._ambient = math.nan if content["ambient"] is None else content["ambient"]
        self._last, self.counts = self._read, Counter(content["counts"])

    def parsed(self, kind: Kind, payload: bytes, number: int = 0) -> QueuedSample | None:
        """The sample in a message, None if it is malformed. A number that is no temperature is a
        missing reading."""
        try:
            content = json.loads(payload)
            time = content["time"]
            if type(time) not in (int, float) or not 0 < time < LATEST:
                return None
            if kind == "duty":
                driver, rig = self._rig.driver, self._rig
                counts = [content[name] for name in rig.driven]
                if not all(type(count) is int and abs(count) <= driver.counts for count in counts):
                    return None
                ambient = content.get("ambient_degC")
                ambient = _temperature(ambient) if ambient is not None else math.nan
                duty = np.asarray(driver.duty(tuple(counts)), float)
                return QueuedSample(round(time * 1e9), None, duty, ambient, number)
            if not any(name in content for name in self._channels):
                return None
            readings = [_temperature(content.get(name)) for name in self._channels]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
        return QueuedSample(round(time * 1e9), np.array(readings), None, math.nan, number)

    def _take(self) -> None:
        sample = self._waiting.popleft()
        self.number = sample.number
        self.counts["used"] += sample.readings is not None
        self._parts = self._done = 0

    def _apply(self, sample: QueuedSample, duty: Float[np.ndarray, " cells"]) -> None:
        self._duty = duty
        if not math.isnan(sample.ambient):
            self._ambient = sample.ambient


def _temperature(value: object) -> float:
    """A temperature, degC; NaN for anything else."""
    is_number = type(value) in (int, float) and LOWEST <= value <= HIGHEST  # pyright: ignore[reportOperatorIssue]
    return float(value) if is_number else math.nan  # pyright: ignore[reportArgumentType]
