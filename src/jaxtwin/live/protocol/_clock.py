"""Host time: it never steps, counts nanoseconds since 1970, and tests can replace it."""

import ctypes
import sys
import threading
import time
from typing import Protocol, final, runtime_checkable

# The answer of adjtimex(2) if nothing synchronises the clock.
TIME_ERROR = 5

# A number of bytes that is larger than its `struct timex` on any machine.
TIMEX_BYTES = 512


@runtime_checkable
class Clock(Protocol):
    """The clock of the live parts; tests pass a simulated clock."""

    def now(self) -> int:
        """Host time, ns. It increases steadily, whatever happens to the system's clock."""
        ...

    def utc(self) -> int:
        """The time of the system's clock, ns since 1970; it may step."""
        ...

    def is_synchronised(self) -> bool | None:
        """Whether NTP keeps the system's clock; `None` if the system does not say."""
        ...

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Waits until the event is set or the time is over. Returns whether it is set."""
        ...


@final
class SystemClock:
    """The monotonic clock, set to UTC once, when it is made.

    It does not follow the system's clock afterwards, because a step of that clock (NTP, a user)
    would break the time axis of a recording. The recorder notes the difference of the two.
    """

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def now(self) -> int:
        """Host time, ns since 1970 as of the start; it increases steadily."""
        return time.monotonic_ns() + self._offset

    def utc(self) -> int:
        """The time of the system's clock, ns since 1970; it may step."""
        return time.time_ns()

    def is_synchronised(self) -> bool | None:
        """Whether NTP keeps the system's clock, as Linux says; `None` on other systems."""
        if sys.platform != "linux":
            return None
        # adjtimex(2) with no mode set only reads. It answers with the state of the clock.
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(TIMEX_BYTES))
        return None if state < 0 else state != TIME_ERROR

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Waits until the event is set or the time (s) is over. Returns whether it is set."""
        return event.wait(seconds)


def seconds(nanoseconds: int | float) -> float:
    """Converts nanoseconds to seconds."""
    return nanoseconds * 1e-9
