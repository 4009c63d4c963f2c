"""A clock that tests turn by hand, and benches that live on it: no waiting, no threads."""

import threading
from collections.abc import Mapping
from typing import Any

from jaxtwin.live import InProcess, Recorder, RigConnection, VirtualRig
from jaxtwin.rig import Rig

START = 1_700_000_000_000_000_000  # ns since 1970: the size that real stamps have


class HandClock:
    """Stands still but where somebody waits or turns it."""

    def __init__(self) -> None:
        self.time = START
        self.waits: list[float] = []

    def now(self) -> int:
        return self.time

    def utc(self) -> int:
        return self.time

    def is_synchronised(self) -> bool | None:
        return None

    def wait(self, event: threading.Event, seconds: float) -> bool:
        self.waits.append(seconds)
        self.turn(seconds)
        return event.is_set()

    def turn(self, seconds: float) -> None:
        self.time += round(seconds * 1e9)


class ScriptedTransport:
    """A connection that yields what a test gave it; an exception in the list is raised."""

    def __init__(self, *reads: bytes | OSError):
        self.reads = list(reads)
        self.written: list[bytes] = []
        self.closed = False

    def read(self) -> bytes:
        item = self.reads.pop(0) if self.reads else b""
        if isinstance(item, OSError):
            raise item
        return item

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        self.closed = True


def stepped_bench(
    rig: Rig,
    openers: Mapping[str, Any],
    clock: HandClock,
    *,
    journal: Recorder | None = None,
    step: float = 0.05,
) -> RigConnection:
    """A bench whose polls turn the clock and read the links themselves."""
    bench = RigConnection(rig, openers, journal=journal, clock=clock)
    poll = bench.poll

    def stepped(timeout: float = 0.1) -> list[Any]:
        clock.turn(step)
        bench.step_links()
        return poll(0.0)

    bench.poll = stepped  # pyright: ignore[reportAttributeAccessIssue]
    return bench


def virtual_bench(
    rig: Rig, device: VirtualRig, clock: HandClock, *, journal: Recorder | None = None
) -> RigConnection:
    """A stepped bench with a virtual rig at its end."""
    openers = {"rig": lambda: InProcess(device, clock)}
    return stepped_bench(rig, openers, clock, journal=journal)
