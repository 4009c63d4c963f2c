"""Checks whether a device's clock is plausible: it must run about as fast as the host's, and never
back."""

from typing import NamedTuple, final

from ...errors import LinkError
from ._records import Stream

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
