"""Interlock: silence, a lost link, or a device that restarts or greets as another."""

from collections.abc import Mapping
from typing import final

from .._errors import JaxtwinError
from ._identity import WATCHDOG_SECONDS
from ._records import Event, Greeting, LinkChange, LinkState, Reading, Record, Sample
from ._time import seconds
from ._trip import Trip


@final
class Presence:
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
        self._boots: Mapping[str, str] = {}
        self._sample = self._reading = 0
        self._recalibrating = False

    def begin(self, now: int, boots: Mapping[str, str]) -> None:
        """Begins to check for silence; `boots` are the present starts of the devices by link."""
        self._sample = self._reading = now
        self._boots = boots

    def see(self, record: Record) -> Trip | None:
        match record:
            case Sample() if record.pwm:  # that of another device hides no silent controller
                self._sample = max(self._sample, record.arrival)
            case Reading():
                self._recalibrating = record.recalibrating
                if not record.recalibrating:
                    self._reading = max(self._reading, record.arrival)
            case Event(kind="refused"):
                return Trip("refused", f"{record.link}: {record.detail}")
            case LinkChange(state=LinkState.DOWN):
                return Trip("link-down", f"link {record.link} is down: {record.detail}")
            case Greeting() if self._boots.get(record.link) != record.hello.boot:
                return Trip("restart", f"the device on {record.link} has restarted")
        return None

    def check(self, now: int) -> Trip | None:
        for what, last in (("controller sample", self._sample), ("temperature", self._reading)):
            silent = seconds(now - last)
            if silent > self._silence:
                camera = ": the camera recalibrates itself" if self._recalibrating else ""
                camera = camera if what == "temperature" else ""
                return Trip("silence", f"no {what} for {silent:.1f} s{camera}")
        return None
