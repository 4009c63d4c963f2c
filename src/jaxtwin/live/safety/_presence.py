"""Interlock: silence, late readings, a lost link, a device that restarts or greets as another."""

from collections.abc import Mapping
from typing import Any, final

from ...errors import JaxtwinError
from ..protocol._clock import seconds
from ..protocol._identity import WATCHDOG_SECONDS
from ..protocol._records import (
    Command,
    Document,
    Event,
    Greeting,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Sample,
)
from ..protocol._rig_state import CLOCK_DRIFT, BootClock, RigState
from ._interlock import AbstractInterlock, Finding


@final
class Presence(AbstractInterlock):
    """Trips on silence, late readings, a lost link, or a device that has restarted or greets as
    another.

    A frame that the camera took while it recalibrated itself does not count as a reading. A sample
    or a reading is as old as the clock of its device says, not as its arrival: a frame that has
    waited shows a plate that was cooler. Its clock also tells of frames that were late before: if
    it gains on the host's, either the messages until now had waited, or it is wrong.

    **Arguments:**

    - `silence`: the largest age of the newest controller sample and of the newest temperatures, s:
      at most the longest time of a device's watchdog.

    **Raises:** `JaxtwinError` for a longer one.
    """

    def __init__(self, silence: float):
        longest = WATCHDOG_SECONDS[1]
        if not 0 < silence <= longest:
            raise JaxtwinError(
                f"silence: expected at most {longest:g} s, for which the watchdog of a device may "
                f"wait too, and more than 0 s, got {silence:g} s; a rig does not heat unseen"
            )
        self._silence = silence
        self._boots: Mapping[str, str] | None = None  # at the first command
        self._began: Mapping[str, BootClock] = {}  # the clocks of the devices then

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"silence_s": self._silence}

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        match record:
            case Document(kind="start"):  # what was commanded before belongs to another run
                self._boots = None
            case Command(kind="duty") if self._boots is None:
                self._boots, self._began = state.boots, state.clocks
            case _ if self._boots is None:
                return None
            case Event(kind="refused"):
                return Finding("refused", f"{record.link}: {record.detail}", record.link)
            case LinkChange(state=LinkState.DOWN):
                detail = f"link {record.link} is down: {record.detail}"
                return Finding("link-down", detail, record.link)
            case Greeting() if self._boots.get(record.link) != record.hello.boot:
                return Finding("restart", f"the device on {record.link} has restarted", record.link)
            case Sample() | Reading():
                return self._gains(record, state)
        return None

    def on_time(self, state: RigState, now: int) -> Finding | None:
        if self._boots is None:
            return None
        newest = {"controller sample": state.sample, "temperature": state.reading}
        for what, record in newest.items():
            if record is None:
                return Finding("silence", f"no {what} has come")
            silent, age = seconds(now - record.arrival), state.age(record, now)
            if age <= self._silence:
                continue
            if silent < age / 2:  # it has come, but late
                return Finding(
                    "late",
                    f"the newest {what} is {age:.1f} s old by the clock of the device on "
                    f"{record.link}: it has waited on the way, or that clock is slow",
                    record.link,
                )
            camera = what == "temperature" and state.recalibrating
            why = ": the camera recalibrates itself" if camera else ""
            return Finding("silence", f"no {what} for {age:.1f} s{why}")
        return None

    def _gains(self, record: Sample | Reading, state: RigState) -> Finding | None:
        """Checks whether the clock of a device has gained on the host's since the first command."""
        now, began = state.clocks.get(record.link), self._began.get(record.link)
        if now is None or began is None or now.boot != began.boot:
            return None
        allowed = self._silence + CLOCK_DRIFT * seconds(now.arrival - began.arrival)
        gained = seconds(began.least_lag - now.least_lag)
        if gained <= allowed:
            return None
        return Finding(
            "clock",
            f"the clock of the device on {record.link} has gained {gained:.1f} s since the start: "
            "what arrived before was late, or that clock is wrong",
            record.link,
        )
