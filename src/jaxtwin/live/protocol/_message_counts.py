"""Sequence numbers of a device: repeated messages, missing messages, steps of its clock."""

from collections.abc import Mapping
from typing import NamedTuple, final

from ._device_time import DeviceTime
from ._records import Stream

BOOTS = 8  # starts of a device whose counters are remembered


class Counted(NamedTuple):
    """The point up to which a stream of one start of a device has been recorded.

    - `expected`: the number of the next message.
    - `device_us`: the device's time of the last message, microseconds.
    """

    expected: int
    device_us: int


# Start of a device (`boot`) -> stream -> `Counted`.
Counters = Mapping[str, Mapping[Stream, Counted]]


class Place(NamedTuple):
    """The position of a message in its stream.

    - `first`, `missing`: first number and count of the messages that are missing before it.
    - `boot`: the start of the device to which it belongs. A step of the device's clock counts as a
        new start, because each start has a single clock.
    """

    first: int
    missing: int
    boot: str


@final
class MessageCounts:
    """Counts the messages of all starts of the devices on a link.

    **Arguments:**

    - `counted`: the last messages that were counted in an earlier run.
    """

    def __init__(self, counted: Counters | None = None):
        self._counts: dict[str, dict[Stream, Counted]] = {
            boot: dict(streams) for boot, streams in (counted or {}).items()
        }
        self._times: dict[str, DeviceTime] = {}
        self._names = _names_after_steps(tuple(self._counts))

    def begin(self, boot: str, rate: float) -> str:
        """Registers a greeting. Returns the name under which its device is counted."""
        # The latest greeting is the last entry: the first ones are forgotten.
        self._names[boot] = name = self._names.pop(boot, boot)
        self._counts[name] = self._counts.pop(name, {})
        clock = self._times.pop(name, None)
        self._times[name] = DeviceTime(rate, _steps(name, boot)) if clock is None else clock
        for known in (self._counts, self._times, self._names):
            while len(known) > BOOTS:
                del known[next(iter(known))]
        return name

    def place(
        self, boot: str, stream: Stream, seq: int, device_us: int, arrival: int
    ) -> Place | None:
        """Returns the position of a message; `None` if it was counted before.

        **Raises:** `LinkError` if its time is implausible. It is then not counted, and the next
        message reports its number as missing.
        """
        counts, time = self._counts[boot], self._times[boot]
        known = counts.get(stream)
        missing = 0 if known is None else (seq - known.expected) % 2**32
        if missing >= 2**31:
            return None
        if time.check(stream, device_us, arrival, 0 if known is None else known.device_us):
            boot = self._stepped(boot)
        self._counts[boot][stream] = Counted((seq + 1) % 2**32, device_us)
        return Place(seq if known is None else known.expected, missing, boot)

    def _stepped(self, boot: str) -> str:
        """Continues with the same numbers and a new clock, under a new name."""
        origin = next(first for first, name in self._names.items() if name == boot)
        time = self._times.pop(boot)
        name = _name_after(origin, time.steps)
        self._names[origin] = name
        self._times[name] = time
        self._counts[name] = {
            stream: Counted(counted.expected, 0)
            for stream, counted in self._counts.pop(boot).items()
        }
        return name


def _name_after(origin: str, steps: int) -> str:
    """Returns the name under which a start of a device is counted after some steps of its clock."""
    return f"{origin[:24]}.{steps}" if steps else origin


def _steps(name: str, origin: str) -> int:
    """Returns the number of clock steps of the start that is counted under this name."""
    return 0 if name == origin else int(name.rpartition(".")[2])


def _names_after_steps(counted: tuple[str, ...]) -> dict[str, str]:
    """The last name of each start whose clock stepped in an earlier run, in order of greetings."""
    names: dict[str, str] = {}
    for origin in counted:
        steps = 1
        while (name := _name_after(origin, steps)) in counted:
            names[origin] = name
            steps += 1
    return names
