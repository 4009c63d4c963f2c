"""Alarms of an unattended recording. Each has a severity and is latched: it is raised again only
after its cause was absent."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np

from ._records import LinkChange, LinkState, Reading, Record, Sample
from ._time import seconds
from ._trip import Trip

DISK_BYTES = 2**30
"""Free space below which the disk counts as nearly full."""

DISK_SECONDS = 10.0
"""Interval between two checks of the disk, s."""

CALM_SECONDS = 10.0
"""An alarm is over when its cause has been absent for this time, s."""

_Key = tuple[str, str]  # the kind of an alarm, and the channel or the link that has it


@final
class Alarms:
    """Watches records as they are written. Apart from records it reads only the disk's free space.

    Each channel and each link has alarms of its own, so that none hides another. A cause is absent
    only if a record says so: a hot channel whose sensor fails, or falls silent, remains hot.

    **Arguments:**

    - `channels`: names of the temperatures.
    - `hottest`: the temperature above which a reading raises an alarm, degC; None for no alarm.
    - `silence`: the longest time without data or temperatures, s.
    - `file`: the recording; its disk is watched.
    - `now`: host time at the start, ns.
    """

    def __init__(
        self, channels: Sequence[str], hottest: float | None, silence: float, file: Path, now: int
    ):
        self._channels, self._hottest, self._silence = channels, hottest, silence
        self._folder = file.absolute().parent
        self._sample = self._reading = now
        self._looked = 0
        self._present: dict[_Key, str] = {}  # the causes that are there, and their details
        self._latched: dict[_Key, int] = {}  # alarms that are on, and when their cause was there

    def check(self, records: Sequence[Record], now: int) -> list[Trip]:
        """Returns the alarms that are new, critical ones first. Those of one kind are one alarm,
        whose detail names all channels or links."""
        causes: dict[_Key, str] = {}
        for record in records:
            self._see(record)
            causes = self._present | causes  # also one that is gone with the next record
        self._check_silence(now)
        self._check_disk(now)
        causes = self._present | causes
        new: dict[str, list[str]] = {}
        for kind, about in causes:
            if (kind, about) not in self._latched:
                new.setdefault(kind, []).append(causes[kind, about])
        self._latched |= dict.fromkeys(causes, now)
        self._latched = {
            key: last for key, last in self._latched.items() if seconds(now - last) <= CALM_SECONDS
        }
        alarms = [Trip(kind, ", ".join(details)) for kind, details in new.items()]
        return sorted(alarms, key=lambda alarm: alarm.severity)

    def _see(self, record: Record) -> None:
        match record:
            case Sample():
                if record.pwm:  # that of another device hides no silent controller
                    self._sample = record.arrival
                detail = f"the device is off: {record.trip}"
                self._set(("device-trip", record.link), bool(record.trip), detail)
            case Reading() if not record.recalibrating:
                self._reading = record.arrival
                for name, value in zip(self._channels, record.temperatures.tolist(), strict=True):
                    self._see_channel(name, value)
            case LinkChange(state=LinkState.DOWN):
                detail = f"{record.link} is down: {record.detail}"
                self._set(("link-down", record.link), True, detail)
            case LinkChange(state=LinkState.LIVE):
                self._set(("link-down", record.link), False)

    def _see_channel(self, name: str, value: float) -> None:
        failed = bool(np.isnan(value))
        self._set(("channel-fault", name), failed, f"{name} failed")
        if self._hottest is not None and not failed:
            hot = value > self._hottest
            self._set(("over-temperature", name), hot, f"{name} is at {value:.1f} degC")

    def _check_silence(self, now: int) -> None:
        for what, last in (("controller sample", self._sample), ("temperature", self._reading)):
            silent = seconds(now - last) > self._silence
            detail = f"no {what} for more than {self._silence:g} s"
            self._set((f"stale-{what.split()[0]}", ""), silent, detail)

    def _check_disk(self, now: int) -> None:
        if seconds(now - self._looked) < DISK_SECONDS:
            return
        self._looked = now
        free = shutil.disk_usage(self._folder).free
        detail = f"{free / 1e6:.0f} MB are free at {self._folder}"
        self._set(("disk", ""), free < DISK_BYTES, detail)

    def _set(self, key: _Key, there: bool, detail: str = "") -> None:
        """Registers that a cause is there, or that it is absent."""
        if there:
            self._present[key] = detail
        else:
            self._present.pop(key, None)
