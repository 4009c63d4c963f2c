"""Interlock: silence, a lost link, or a device that restarts or greets as another."""

import math
from collections.abc import Mapping
from typing import Any, final

from ..._errors import JaxtwinError
from ..protocol._clock import seconds
from ..protocol._identity import WATCHDOG_SECONDS
from ..protocol._records import Command, Document, Event, Greeting, LinkChange, LinkState, Record
from ..protocol._rig_state import RigState
from ._finding import Finding
from ._interlock import AbstractInterlock


@final
class Presence(AbstractInterlock):
    """Trips on silence, a lost link, or a device that has restarted or greets as another.

    A frame that the camera took while it recalibrated itself does not count as a reading.

    **Arguments:**

    - `silence`: longest time without a controller sample, or without temperatures, s: at most the
      longest time of a device's watchdog.

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

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"silence_s": self._silence}

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        match record:
            case Document(kind="start"):  # what was commanded before belongs to another run
                self._boots = None
            case Command(kind="duty") if self._boots is None:
                self._boots = state.boots
            case _ if self._boots is None:
                return None
            case Event(kind="refused"):
                return Finding("refused", f"{record.link}: {record.detail}", record.link)
            case LinkChange(state=LinkState.DOWN):
                detail = f"link {record.link} is down: {record.detail}"
                return Finding("link-down", detail, record.link)
            case Greeting() if self._boots.get(record.link) != record.hello.boot:
                return Finding("restart", f"the device on {record.link} has restarted", record.link)
        return None

    def on_time(self, state: RigState, now: int) -> Finding | None:
        if self._boots is None:
            return None
        newest = {"controller sample": state.sample, "temperature": state.reading}
        for what, record in newest.items():
            # The time of arrival: what waited in a buffer has been heard of nevertheless.
            silent = math.inf if record is None else seconds(now - record.arrival)
            if silent > self._silence:
                camera = what == "temperature" and state.recalibrating
                why = ": the camera recalibrates itself" if camera else ""
                return Finding("silence", f"no {what} for {silent:.1f} s{why}")
        return None
