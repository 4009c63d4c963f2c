"""Alarms of an unattended recording. An alarm is raised again only after its cause was absent."""

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


@final
class Alarms:
    """Watches records as they are written. Apart from records it reads only the disk's free space.

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
        self._seen: dict[str, int] = {}  # alarms that are on, and when their cause was last there

    def check(self, records: Sequence[Record], now: int) -> list[Trip]:
        """Returns the alarms that are new."""
        causes: list[Trip] = []
        for record in records:
            match record:
                case Sample():
                    self._sample = record.arrival
                    if record.trip:
                        causes.append(Trip("device-trip", f"the device is off: {record.trip}"))
                case Reading() if not record.recalibrating:
                    self._reading = record.arrival
                    causes += self._reading_alarms(record)
                case LinkChange(state=LinkState.DOWN):
                    causes.append(Trip("link-down", f"{record.link} is down: {record.detail}"))
        for what, last in (("controller sample", self._sample), ("temperature", self._reading)):
            if seconds(now - last) > self._silence:
                name = f"stale-{what.split()[0]}"
                causes.append(Trip(name, f"no {what} for more than {self._silence:g} s"))
        causes += self._disk(now)
        new = [cause for cause in causes if cause.kind not in self._seen]
        for cause in causes:
            self._seen[cause.kind] = now
        over = [kind for kind, last in self._seen.items() if seconds(now - last) > CALM_SECONDS]
        for kind in over:
            del self._seen[kind]
        return list({cause.kind: cause for cause in reversed(new)}.values())[::-1]

    def _reading_alarms(self, reading: Reading) -> list[Trip]:
        values = reading.temperatures
        failed = np.flatnonzero(np.isnan(values))
        if len(failed):
            names = ", ".join(self._channels[int(place)] for place in failed)
            return [Trip("channel-fault", f"{names} failed")]
        hottest = int(np.argmax(values))
        if self._hottest is None or values[hottest] <= self._hottest:
            return []
        name, value = self._channels[hottest], values[hottest]
        return [Trip("over-temperature", f"{name} is at {value:.1f} degC")]

    def _disk(self, now: int) -> list[Trip]:
        if seconds(now - self._looked) < DISK_SECONDS:
            return []
        self._looked = now
        free = shutil.disk_usage(self._folder).free
        if free >= DISK_BYTES:
            return []
        return [Trip("disk", f"{free / 1e6:.0f} MB are free at {self._folder}")]
