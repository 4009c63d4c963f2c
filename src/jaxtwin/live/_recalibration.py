"""A camera's recalibrations: a shutter that closes, and an offset that jumps and fades."""

import math
from typing import final

import numpy as np

SHUTTER_SECONDS = 1.0
"""Time for which a recalibration freezes the image, s."""

JUMP_KELVIN, JUMP_DECAY = 0.8, 25.0
"""Size and duration of the change of the camera's offset at a recalibration."""


@final
class Recalibrations:
    """When the shutter is closed, and the offset, as time goes on.

    The virtual rig and a simulated closed loop with the same seed see the same jumps.

    **Arguments:**

    - `interval`: between two of them, s; 0: never.
    - `seed`: of the jumps.
    """

    def __init__(self, interval: float, seed: int):
        self._interval = interval
        self._random = np.random.default_rng([seed, 1])
        self._at = self._jump = 0.0

    def advance(self, time: float) -> None:
        """Advances to a time, s."""
        while self._interval and time >= self._at + self._interval:
            self._at += self._interval
            self._jump = self._random.normal(0, JUMP_KELVIN)

    def is_closed(self, time: float) -> bool:
        """Whether the shutter is closed."""
        return self._at > 0 and time - self._at < SHUTTER_SECONDS

    def offset(self, time: float) -> float:
        """Offset of all pixels, K."""
        return self._jump * math.exp(-(time - self._at) / JUMP_DECAY)
