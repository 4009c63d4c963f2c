"""Plausibility of a device's clock: it runs about as fast as the host's, and never back."""

from typing import final

from .._errors import LinkError

AHEAD = 60.0
"""How far a device's time may run ahead of the host's, s of the host. Bytes that waited in a buffer
at the start, or during a pause of the host, have this effect."""

FASTER = 1.01
"""Highest plausible ratio of a device's clock to the host's; crystals are far more accurate."""

AGREE = 10
"""After so many implausible messages in a row that are consistent with each other, the clock is
taken to have stepped."""


@final
class DeviceTime:
    """The clock of one start of a device, as its messages show it.

    **Arguments:**

    - `rate`: seconds of device time in a second.
    """

    def __init__(self, rate: float):
        self.steps = 0
        """Number of steps of the clock."""
        self._rate = rate
        self._first: tuple[int, int] | None = None  # device microseconds, arrival in ns
        self._doubted: tuple[int, int] | None = None
        self._agreeing = 0

    def check(self, device_us: int, arrival: int) -> bool:
        """Checks the time of a message. Returns whether the clock has stepped, and is accepted.

        **Raises:** `LinkError` for an implausible time. If the host accepted it, it would refuse
        all later messages until the device's clock had caught up with it.
        """
        if self._first is None:
            self._first = device_us, arrival
        if self._believable(self._first, device_us, arrival):
            self._agreeing = 0
            self._doubted = None
            return False
        if self._doubted is None or not self._believable(self._doubted, device_us, arrival):
            self._doubted, self._agreeing = (device_us, arrival), 0
        self._agreeing += 1
        if self._agreeing < AGREE:
            ahead = (device_us - self._first[0]) * 1e-6 / self._rate
            passed = (arrival - self._first[1]) * 1e-9
            raise LinkError(
                f"device time {device_us}: {ahead:.6g} s after the first message, of which the "
                f"host saw {passed:.6g} s"
            )
        self._first, self._doubted, self._agreeing = (device_us, arrival), None, 0
        self.steps += 1
        return True

    def _believable(self, since: tuple[int, int], device_us: int, arrival: int) -> bool:
        device = (device_us - since[0]) * 1e-6 / self._rate
        host = (arrival - since[1]) * 1e-9
        return -AHEAD <= device <= host * FASTER + AHEAD
