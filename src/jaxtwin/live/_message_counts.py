"""Each message of a device once: what was seen before, what is missing, when its clock steps."""

from typing import NamedTuple, final

from .._errors import LinkError
from ._counted import Counted, Counters
from ._device_time import DeviceTime
from ._records import Stream

BOOTS = 8  # starts of a device whose counters are remembered


class Place(NamedTuple):
    """Where a message stands in its stream.

    - `first`, `missing`: the numbers before it that never came: the first of them, and how many.
    - `boot`: the start of the device that it belongs to; another one than before where the device's
        clock has stepped, since one start has one clock.
    """

    first: int
    missing: int
    boot: str


@final
class MessageCounts:
    """Counts the messages of all starts of the devices on a link.

    **Arguments:**

    - `counted`: how far they were counted already, in an earlier run.
    """

    def __init__(self, counted: Counters | None = None):
        self._counts: dict[str, dict[Stream, Counted]] = {
            boot: dict(streams) for boot, streams in (counted or {}).items()
        }
        self._times: dict[str, DeviceTime] = {}
        self._names: dict[str, str] = {}

    def begin(self, boot: str, rate: float) -> str:
        """A device greets; under which name its present start is counted."""
        name = self._names.setdefault(boot, boot)
        self._counts.setdefault(name, {})
        self._times.setdefault(name, DeviceTime(rate))
        for known in (self._counts, self._times, self._names):
            while len(known) > BOOTS:
                del known[next(iter(known))]
        return name

    def place(
        self, boot: str, stream: Stream, seq: int, device_us: int, arrival: int
    ) -> Place | None:
        """Counts a message; `None` where it was counted before.

        **Raises:** `LinkError` where its time cannot be true. It is not counted then: its number
        shows as missing with the next one.
        """
        counts, time = self._counts[boot], self._times[boot]
        known = counts.get(stream)
        missing = 0 if known is None else (seq - known.expected) % 2**32
        if missing >= 2**31:
            return None
        if time.check(device_us, arrival):
            boot = self._stepped(boot)
        elif known is not None and device_us < known.device_us:
            raise LinkError(f"device time {device_us} after {known.device_us}")
        self._counts[boot][stream] = Counted((seq + 1) % 2**32, device_us)
        return Place(seq if known is None else known.expected, missing, boot)

    def _stepped(self, boot: str) -> str:
        """Goes on with the same numbers and another clock, under another name."""
        origin = next(first for first, name in self._names.items() if name == boot)
        time = self._times.pop(boot)
        name = f"{origin[:24]}.{time.steps}"
        self._names[origin] = name
        self._times[name] = time
        self._counts[name] = {
            stream: Counted(counted.expected, 0)
            for stream, counted in self._counts.pop(boot).items()
        }
        return name
