"""A camera's recalibrations: a shutter that closes, and an offset that jumps and fades."""

from typing import final

import numpy as np

from ..rig import CommonError

# The time for which a recalibration freezes the image, s.
SHUTTER_SECONDS = 1.0

# Size (K) and duration (s) of a jump of the camera's offset, if the rig file states none.
JUMP_KELVIN, JUMP_DECAY = 0.8, 25.0


@final
class Recalibrations:
    r"""The recalibrations of a camera: the times at which its shutter is closed, and its offset.

    At a recalibration the offset jumps to $\sum_j b_j$ and fades as $\sum_j b_j e^{-t / \tau_j}$.
    The time constants are those of `[camera.common_error]`, and each $b_j$ is drawn from the prior
    that a match has for it: normal, with the standard deviation `jump`.

    The virtual rig and a simulated closed loop with the same seed see the same jumps.

    **Arguments:**

    - `interval`: the time between two recalibrations, s; 0: never.
    - `seed`: the seed of the jumps.
    - `common_error`: the common error in the rig file; None for `JUMP_KELVIN` and `JUMP_DECAY`.
    """

    def __init__(self, interval: float, seed: int, common_error: CommonError | None):
        self._interval = interval
        self._random = np.random.default_rng([seed, 1])
        self._size, relaxation = JUMP_KELVIN, (JUMP_DECAY,)
        if common_error is not None:
            self._size, relaxation = common_error.jump, common_error.relaxation
        self._relaxation = np.array(relaxation)
        self._jump = np.zeros(len(relaxation))
        self._at = 0.0

    def advance(self, time: float) -> None:
        """Advances to a time, s."""
        while self._interval and time >= self._at + self._interval:
            self._at += self._interval
            self._jump = self._random.normal(0, self._size, len(self._relaxation))

    def is_closed(self, time: float) -> bool:
        """Whether the shutter is closed."""
        return self._at > 0 and time - self._at < SHUTTER_SECONDS

    def offset(self, time: float) -> float:
        """Offset of all pixels, K."""
        return float(self._jump @ np.exp(-(time - self._at) / self._relaxation))
