"""Alarms of an unattended recording. Each has a severity and is latched: it is raised again only
after its cause was absent."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import final

import numpy as np

from .protocol._clock import seconds
from .protocol._records import LinkChange, LinkState, Reading, Record, Sample
from .protocol._rig_state import RigState
from .safety._interlock import Finding

# Free space below which the disk counts as nearly full.
DISK_BYTES = 2**30

# Interval between two checks of the disk, s.
DISK_SECONDS = 10.0

# An alarm is over when its cause has been absent for this time, s.
CALM_SECONDS = 10.0

# The alarms at which somebody must come: the rig is too hot, or nobody can know.
_CRITICAL = frozenset({"over-temperature", "stale-temperature"})

_Key = tuple[str, str]  # the kind of an alarm, and the channel or the link that has it


@final
class Alarms:
    """Raises alarms. It consumes the records of a source, and reads the disk's free space.

    Each channel and each link has alarms of its own, so that none hides another. A cause is absent
    only if a record says so: a hot channel whose sensor fails, or falls silent, remains hot.

    **Arguments:**

    - `channels`: names of the temperatures.
    - `hottest`: the temperature above which a reading raises an alarm, degC; None for no alarm.
    - `silence`: the longest time without data or temperatures, s.
    - `file`: the recording; its disk is watched.
    - `now`: host time at the start, ns.
    - `on_alarm`: called with each new alarm. Those of one kind that begin together are one alarm,
      whose detail names all channels or links; critical ones come first.
    """

    def __init__(
        self,
        channels: Sequence[str],
        hottest: float | None,
        silence: float,
        file: Path,
        now: int,
        on_alarm: Callable[[Finding], None],
    ):
        self._channels, self._hottest, self._silence = channels, hottest, silence
        self._on_alarm = on_alarm
        self._folder = file.absolute().parent
        # The host time of the newest sample and reading, ns; at first that of the start.
        self._newest = {"stale-controller": now, "stale-temperature": now}
        self._causes: dict[_Key, str] = {}  # those since the last turn
        self._looked = 0
        self._present: dict[_Key, str] = {}  # the causes that are there, and their details
        self._latched: dict[_Key, int] = {}  # alarms that are on, and when their cause was there

    def on_record(self, record: Record, state: RigState) -> None:
        """Looks for causes of alarms in a record."""
        match record:
            case Sample():
                detail = f"the device is off: {record.trip}"
                self._set(("device-trip", record.link), bool(record.trip), detail)
            case Reading() if not record.recalibrating:
                for name, value in zip(self._channels, record.temperatures.tolist(), strict=True):
                    self._see_channel(name, value)
            case LinkChange(state=LinkState.DOWN):
                detail = f"{record.link} is down: {record.detail}"
                self._set(("link-down", record.link), True, detail)
            case LinkChange(state=LinkState.LIVE):
                self._set(("link-down", record.link), False)
        self._causes = self._present | self._causes  # also one that is gone with the next record

    def on_time(self, state: RigState, now: int) -> None:
        """Looks for silence and for a full disk, and raises the alarms that are new."""
        self._check_silence(state, now)
        self._check_disk(now)
        causes = self._present | self._causes
        self._causes = {}
        new: dict[str, list[_Key]] = {}
        for key in causes:
            if key not in self._latched:
                new.setdefault(key[0], []).append(key)
        self._latched |= dict.fromkeys(causes, now)
        self._latched = {
            key: last for key, last in self._latched.items() if seconds(now - last) <= CALM_SECONDS
        }
        alarms = [
            Finding(
                kind,
                ", ".join(causes[key] for key in keys),
                ", ".join(about for _, about in keys),
                now,
                "critical" if kind in _CRITICAL else "warning",
            )
            for kind, keys in new.items()
        ]
        for alarm in sorted(alarms, key=lambda alarm: alarm.severity != "critical"):
            self._on_alarm(alarm)

    def _see_channel(self, name: str, value: float) -> None:
        failed = bool(np.isnan(value))
        self._set(("channel-fault", name), failed, f"{name} failed")
        if self._hottest is not None and not failed:
            hot = value > self._hottest
            self._set(("over-temperature", name), hot, f"{name} is at {value:.1f} degC")

    def _check_silence(self, state: RigState, now: int) -> None:
        streams = (
            ("stale-controller", "controller sample", state.sample),
            ("stale-temperature", "temperature", state.reading),
        )
        for kind, what, record in streams:
            if record is not None:
                self._newest[kind] = state.made(record)
            silent = seconds(now - self._newest[kind])
            detail = f"no {what} for more than {self._silence:g} s"
            self._set((kind, ""), silent > self._silence, detail)

    def _check_disk(self, now: int) -> None:
        if seconds(now - self._looked) < DISK_SECONDS:
            return
        self._looked = now
        free = shutil.disk_usage(self._folder).free
        detail = f"{free / 1e6:.0f} MB are free at {self._folder}"
        self._set(("disk", ""), free < DISK_BYTES, detail)

    def _set(self, key: _Key, is_present: bool, detail: str = "") -> None:
        """Registers that a cause is present, or that it is absent."""
        if is_present:
            self._present[key] = detail
        else:
            self._present.pop(key, None)
