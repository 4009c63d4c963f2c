"""A clock for tests of a host and a device in two threads, on machines that may be busy."""

import threading
import time
from typing import final

# How far time runs ahead of a thread that has not looked at the clock since, ns.
MOST_AHEAD = 30_000_000

# How long a thread may not look at the clock, ns: one that has ended never does again.
LONGEST_WAIT = 300_000_000_000


@final
class PatientClock:
    """The system's clock, but it stands still while a thread that uses it waits for the processor.

    On a free machine it is `SystemClock`. On a busy one, neither of two threads sees the other
    stand still for longer than `MOST_AHEAD`.

    **Arguments:**

    - `threads`: names of the threads that look at it again and again.

    **Raises:** `TimeoutError` if one of them has not for `LONGEST_WAIT`.
    """

    def __init__(self, *threads: str):
        self._lock = threading.Lock()
        self._real = time.monotonic_ns()
        self._time = time.time_ns()
        self._seen = dict.fromkeys(threads, self._time)
        self._looked = dict.fromkeys(threads, self._real)

    def now(self) -> int:
        with self._lock:
            before, self._real = self._real, time.monotonic_ns()
            bound = min(self._seen.values()) + MOST_AHEAD
            self._time = max(self._time, min(self._time + self._real - before, bound))
            name = threading.current_thread().name
            if name in self._seen:
                self._seen[name], self._looked[name] = self._time, self._real
            absent = min(self._looked, key=lambda name: self._looked[name])
            if self._real - self._looked[absent] > LONGEST_WAIT:
                raise TimeoutError(f"expected the thread {absent!r} to run, it has ended or hangs")
            return self._time

    def utc(self) -> int:
        return self.now()

    def is_synchronised(self) -> bool | None:
        return None

    def wait(self, event: threading.Event, seconds: float) -> bool:
        return event.wait(seconds)
