"""Whether a device's clock can be believed: it runs about as fast as the host's, and never back."""

from typing import final

from .._errors import LinkError

AHEAD = 60.0
"""By which a device may be ahead of its own clock, s of the host: bytes that waited in a buffer at
the start, a pause of the host."""

FASTER = 1.01
"""A crystal is never a hundredth too fast."""

AGREE = 10
"""Messages in a row that agree with each other: then the clock has stepped, and they are right."""


@final
class DeviceTime:
    """The clock of one start of a device, as its messages show it.

    **Arguments:**

    - `rate`: seconds of device time in a second.
    """

    def __init__(self, rate: float):
        self.steps = 0
        """How often it has stepped."""
        self._rate = rate
        self._first: tuple[int, int] | None = None  # device microseconds, arrival in ns
        self._doubted: tuple[int, int] | None = None
        self._agreeing = 0

    def check(self, device_us: int, arrival: int) -> bool:
        """Takes the stamp of a message; whether the clock has stepped with it, and is believed.

        **Raises:** `LinkError` where a stamp cannot be true: one alone must not make the host deaf
        until the device's clock has caught up with it.
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
