"""Interlock: readings that are plausible and not too hot."""

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, final

import numpy as np

from ..._arguments import finite_number
from ...errors import JaxtwinError
from ...rig import Driver
from ..protocol._clock import seconds
from ..protocol._records import Reading, Record, Sample
from ..protocol._rig_state import RigState
from ._interlock import AbstractInterlock, Finding
from ._operating_limits import MAX_ROOM_DIFFERENCE_KELVIN, OperatingLimits

# The time over which a rate is computed, s of the rig, so that noise does not count as a rate.
RATE_WINDOW_SECONDS = 2.0


@final
class Plausibility(AbstractInterlock):
    """Trips on a reading that is too hot, or that no working sensor can give.

    **Arguments:**

    - `channels`: the names of the channels.
    - `limits`: the limits of the rig.
    - `driver`: the driver of the cells.
    """

    def __init__(self, channels: tuple[str, ...], limits: OperatingLimits, driver: Driver):
        self._channels = channels
        self._driver = driver
        self._limits = limits
        self._recent: deque[Reading] = deque()
        self._duty = 0.0  # the largest of all cells, 0 to 1
        self._sampled: int | None = None  # when, host time in ns
        self._still = np.zeros(len(channels))  # driven time without a change, s at full duty
        self._last: np.ndarray | None = None

    @property
    def settings(self) -> Mapping[str, Any]:
        return asdict(self._limits)

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        match record:
            case Sample():
                self._count_heat(record, state)
                return self._another_room(record)
            case Reading() if not record.recalibrating:
                return (
                    self._failed(record)
                    or self._out_of_range(record)
                    or self._too_fast(record)
                    or self._frozen(record)
                )
        return None

    def _failed(self, reading: Reading) -> Finding | None:
        for place in np.flatnonzero(~np.isfinite(reading.temperatures)):
            why = reading.faults.get(int(place), "no number")
            name = self._channels[place]
            return Finding("channel-fault", f"{name} has failed: {why}", name)
        return None

    def _count_heat(self, sample: Sample, state: RigState) -> None:
        """Adds the duty since the last sample. It is counted over all pauses: a heater that pulses
        heats as well."""
        if not sample.pwm:
            return
        now = state.time_of(sample)
        if self._sampled is not None:
            self._still += self._duty * seconds(max(now - self._sampled, 0)) * state.rate
        self._sampled = now
        self._duty = float(np.abs(self._driver.duty(sample.pwm)).max())

    def _another_room(self, sample: Sample) -> Finding | None:
        """Checks the measured ambient temperature. The twin relies on it: a wrong one would hide
        cells that are too hot."""
        value, room = sample.ambient, self._limits.room
        if value is None or abs(value - room) <= MAX_ROOM_DIFFERENCE_KELVIN:
            return None
        return Finding(
            "implausible",
            f"the ambient temperature reads {value:.1f} degC; the rig file says {room:.0f}, "
            f"and no room is more than {MAX_ROOM_DIFFERENCE_KELVIN:g} K from it",
        )

    def _out_of_range(self, reading: Reading) -> Finding | None:
        values, limits = reading.temperatures, self._limits
        hottest, coldest = int(np.argmax(values)), int(np.argmin(values))
        if values[hottest] > limits.hottest:
            name, value = self._channels[hottest], values[hottest]
            return Finding(
                "over-temperature",
                f"{name} is at {value:.1f} degC; the rig's limit is {limits.hottest:g}",
                name,
                severity="critical",
            )
        if values[coldest] < limits.lowest:
            name, value = self._channels[coldest], values[coldest]
            return Finding(
                "implausible",
                f"{name} reads {value:.1f} degC; nothing here can be below {limits.lowest:.0f}",
                name,
            )
        return None

    def _too_fast(self, reading: Reading) -> Finding | None:
        recent, limits = self._recent, self._limits
        if recent and recent[-1].boot != reading.boot:
            recent.clear()
        while len(recent) > 1 and _between(recent[1], reading) >= RATE_WINDOW_SECONDS:
            recent.popleft()
        recent.append(reading)
        change = reading.temperatures - recent[0].temperatures
        time = max(_between(recent[0], reading), 0.0)
        worst = int(np.argmax(np.abs(change)))
        if abs(change[worst]) > limits.rate * time + limits.jump:
            return Finding(
                "rate",
                f"{self._channels[worst]} changed by {change[worst]:+.1f} K in {time:.1f} s; "
                f"the rig cannot change faster than {limits.rate:.2g} K/s",
                self._channels[worst],
            )
        return None

    def _frozen(self, reading: Reading) -> Finding | None:
        values = reading.temperatures
        moved = np.ones(len(values), bool) if self._last is None else values != self._last
        self._last = values
        self._still[moved] = 0.0
        worst = int(np.argmax(self._still))
        if self._still[worst] <= self._limits.frozen:
            return None
        return Finding(
            "frozen",
            f"{self._channels[worst]} has read {values[worst]:.2f} degC while the cells got the "
            f"heat of {self._still[worst]:.0f} s at full duty",
            self._channels[worst],
        )


def check_ambient(ambient: float | int | None, limits: OperatingLimits) -> float | None:
    """Checks an ambient temperature that a person gives, degC.

    **Raises:** `JaxtwinError` if it is not a number, or too far from that of the rig file.
    """
    if ambient is None:
        return None
    value = finite_number("ambient", ambient, JaxtwinError)
    if abs(value - limits.room) > MAX_ROOM_DIFFERENCE_KELVIN:
        raise JaxtwinError(
            f"ambient: expected a temperature within {MAX_ROOM_DIFFERENCE_KELVIN:g} K of that of "
            f"the rig file, {limits.room:.0f} degC, got {value:g}"
        )
    return value


def _between(earlier: Reading, later: Reading) -> float:
    return (later.device_us - earlier.device_us) * 1e-6
