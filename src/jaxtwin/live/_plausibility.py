"""Interlock: readings that are plausible and not too hot."""

from collections import deque
from typing import final

import numpy as np

from ._operating_limits import OperatingLimits
from ._records import Greeting, Reading, Record, Sample
from ._trip import Trip

WINDOW = 2.0
"""The time over which a rate is computed, s of the rig, so that noise does not count as a rate."""

ROOM_KELVIN = 30.0
"""Largest difference between the measured ambient temperature and that of the rig file, K."""


@final
class Plausibility:
    """Trips on a reading that is too hot, or that no working sensor can give.

    **Arguments:**

    - `channels`: the names of the channels.
    - `limits`: the limits of the rig.
    """

    def __init__(self, channels: tuple[str, ...], limits: OperatingLimits):
        self._channels = channels
        self._limits = limits
        self._rate = 1.0
        self._recent: deque[Reading] = deque()
        self._driven_since: int | None = None
        self._changed = np.zeros(len(channels), np.int64)  # when, host time in ns
        self._last: np.ndarray | None = None

    def see(self, record: Record) -> Trip | None:
        match record:
            case Greeting():
                self._rate = record.hello.rate
            case Sample():
                if record.pwm and not any(record.pwm):
                    self._driven_since = None
                elif record.pwm and self._driven_since is None:
                    self._driven_since = record.arrival
                return self._another_room(record)
            case Reading() if not record.recalibrating:
                return (
                    self._failed(record)
                    or self._out_of_range(record)
                    or self._too_fast(record)
                    or self._frozen(record)
                )
        return None

    def check(self, now: int) -> Trip | None:
        return None

    def _failed(self, reading: Reading) -> Trip | None:
        for place in np.flatnonzero(~np.isfinite(reading.temperatures)):
            why = reading.faults.get(int(place), "no number")
            return Trip("channel-fault", f"{self._channels[place]} has failed: {why}")
        return None

    def _another_room(self, sample: Sample) -> Trip | None:
        """Checks the measured ambient temperature. The twin relies on it: a wrong one would hide
        cells that are too hot."""
        value, room = sample.ambient, self._limits.room
        if value is None or abs(value - room) <= ROOM_KELVIN:
            return None
        return Trip(
            "implausible",
            f"the ambient temperature reads {value:.1f} degC; the rig file says {room:.0f}, "
            f"and no room is more than {ROOM_KELVIN:g} K from it",
        )

    def _out_of_range(self, reading: Reading) -> Trip | None:
        values, limits = reading.temperatures, self._limits
        hottest, coldest = int(np.argmax(values)), int(np.argmin(values))
        if values[hottest] > limits.hottest:
            name, value = self._channels[hottest], values[hottest]
            return Trip(
                "over-temperature",
                f"{name} is at {value:.1f} degC; the rig's limit is {limits.hottest:g}",
            )
        if values[coldest] < limits.lowest:
            name, value = self._channels[coldest], values[coldest]
            return Trip(
                "implausible",
                f"{name} reads {value:.1f} degC; nothing here can be below {limits.lowest:.0f}",
            )
        return None

    def _too_fast(self, reading: Reading) -> Trip | None:
        recent, limits = self._recent, self._limits
        if recent and recent[-1].boot != reading.boot:
            recent.clear()
        while len(recent) > 1 and _seconds(recent[1], reading) >= WINDOW:
            recent.popleft()
        recent.append(reading)
        change = reading.temperatures - recent[0].temperatures
        time = max(_seconds(recent[0], reading), 0.0)
        worst = int(np.argmax(np.abs(change)))
        if abs(change[worst]) > limits.rate * time + limits.jump:
            return Trip(
                "rate",
                f"{self._channels[worst]} changed by {change[worst]:+.1f} K in {time:.1f} s; "
                f"the rig cannot change faster than {limits.rate:.2g} K/s",
            )
        return None

    def _frozen(self, reading: Reading) -> Trip | None:
        values = reading.temperatures
        moved = np.ones(len(values), bool) if self._last is None else values != self._last
        self._last = values
        self._changed[moved] = reading.arrival
        if self._driven_since is None:
            return None
        still = reading.arrival - np.maximum(self._changed, self._driven_since)
        worst = int(np.argmax(still))
        stood = float(still[worst]) * 1e-9 * self._rate
        if stood <= self._limits.frozen:
            return None
        return Trip(
            "frozen",
            f"{self._channels[worst]} has read {values[worst]:.2f} degC for {stood:.0f} s, "
            "though the cells are driven",
        )


def _seconds(earlier: Reading, later: Reading) -> float:
    return (later.device_us - earlier.device_us) * 1e-6
