"""Sequence numbers of a device: repeated messages, missing messages, steps of its clock."""

from collections.abc import Mapping
from typing import NamedTuple, final

from ...errors import LinkError
from ._records import Stream

# Checks whether a device's clock is plausible: it must run about as fast as the host's, and
# never back.


# The largest time by which a device may run ahead of the host, s of the host. Bytes that waited in
# a buffer at the start, or during a pause of the host, have this effect.
MAX_LEAD_SECONDS = 60.0

# Highest plausible ratio of a device's clock to the host's; crystals are far more accurate.
FASTER = 1.01

# The number of consecutive implausible messages, consistent with each other, after which the clock
# is assumed to have stepped.
AGREE = 10


class _SuspectedStep(NamedTuple):
    """The first of several consecutive implausible messages that are consistent with each other."""

    device_us: int
    arrival: int
    agreeing: int


@final
class DeviceTime:
    """The clock of one start of a device, as its messages show it.

    **Arguments:**

    - `rate`: the seconds of device time in a second.
    - `steps`: the number of steps of the clock in earlier runs.
    """

    def __init__(self, rate: float, steps: int = 0):
        self.steps = steps
        """Number of steps of the clock."""
        self._rate = rate
        self._first: tuple[int, int] | None = None  # device microseconds, arrival in ns
        self._suspected: dict[Stream, _SuspectedStep] = {}

    def check(self, stream: Stream, device_us: int, arrival: int, before: int) -> bool:
        """Checks the time of a message. Returns whether the clock has stepped, and is accepted.

        `before` is the time of the stream's last message, which the time of this one must not
        precede.

        **Raises:** `LinkError` for an implausible time. If the host accepted it, it would refuse
        all later messages until the device's clock had caught up with it.
        """
        if self._first is None:
            self._first = device_us, arrival
        if device_us >= before and self._believable(self._first, device_us, arrival):
            self._suspected.pop(stream, None)
            return False
        suspected = self._suspected.get(stream)
        if suspected is None or not self._believable(suspected[:2], device_us, arrival):
            suspected = _SuspectedStep(device_us, arrival, 0)
        suspected = self._suspected[stream] = suspected._replace(agreeing=suspected.agreeing + 1)
        if suspected.agreeing < AGREE:
            if device_us < before:
                raise LinkError(f"device time {device_us} after {before}")
            ahead = (device_us - self._first[0]) * 1e-6 / self._rate
            passed = (arrival - self._first[1]) * 1e-9
            raise LinkError(
                f"device time {device_us}: {ahead:.6g} s after the first message, of which the "
                f"host saw {passed:.6g} s"
            )
        self._first = device_us, arrival
        self._suspected.clear()
        self.steps += 1
        return True

    def _believable(self, since: tuple[int, int], device_us: int, arrival: int) -> bool:
        device = (device_us - since[0]) * 1e-6 / self._rate
        host = (arrival - since[1]) * 1e-9
        return -MAX_LEAD_SECONDS <= device <= host * FASTER + MAX_LEAD_SECONDS


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
