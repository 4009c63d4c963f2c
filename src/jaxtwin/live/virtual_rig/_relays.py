"""The relays of a device, which switch heaters on and off for shares of a window."""

import math
from typing import final

import numpy as np
from jaxtyping import Float

from ...rig import RelayWindow, Rig

# Times that differ by less are the same, s.
ROUNDING = 1e-9


@final
class Relays:
    """The relays of all heaters of a rig that have one. Windows begin at the start of the device.

    A commanded duty takes effect with the next window. A device that nobody commands, or that has
    tripped, switches off at once, whatever the minimum times: these protect the relay, and off
    protects the rig.

    **Arguments:**

    - `rig`: the rig.
    """

    def __init__(self, rig: Rig):
        self._relays = {column: _Relay(relay) for column, relay in rig.relays.items()}

    def applied(
        self, duty: Float[np.ndarray, " cells"], time: float, *, is_off: bool
    ) -> Float[np.ndarray, " cells"]:
        """The duty of all cells and heaters from a time on, s, with 1 or 0 for those with a relay.

        **Arguments:**

        - `is_off`: whether all relays are to be off at once.
        """
        applied = np.array(duty, float)
        for column, relay in self._relays.items():
            applied[column] = relay.applied(float(duty[column]), time, is_off)
        return applied

    def next_switch(self, time: float) -> float:
        """The next time at which a relay may switch, s; infinite without relays."""
        return min((relay.next_switch(time) for relay in self._relays.values()), default=math.inf)


class _Relay:
    def __init__(self, relay: RelayWindow):
        self._relay = relay
        self._window = -1
        self._on_until = 0.0
        self._carried = 0.0

    def applied(self, duty: float, time: float, is_off: bool) -> float:
        window = math.floor((time + ROUNDING) / self._relay.period)
        if is_off:
            self._window, self._on_until, self._carried = window, time, 0.0
        elif window > self._window:
            on, self._carried = self._relay.on_time(duty, self._carried)
            self._window, self._on_until = window, window * self._relay.period + on
        return float(time + ROUNDING < self._on_until)

    def next_switch(self, time: float) -> float:
        end = self._relay.period * (math.floor((time + ROUNDING) / self._relay.period) + 1)
        return self._on_until if time + ROUNDING < self._on_until < end else end
