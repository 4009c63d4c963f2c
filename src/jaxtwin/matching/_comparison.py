"""The fitted twin compared with a recording: its run, and the camera's common error."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from ..simulation import Run


@final
@dataclass(frozen=True, eq=False)
class CameraError:
    """The camera's error that all channels of a recording share.

    - `events`: times of its flat-field corrections, s.
    - `error`: the part of simulated minus recorded temperature that is the camera's, `(times,)`, K.
    """

    events: tuple[float, ...]
    error: Float[np.ndarray, " times"]

    @property
    def offset(self) -> Float[np.ndarray, " times"]:
        """The amount by which the camera reads too warm, K."""
        return -self.error


@final
@dataclass(frozen=True, eq=False)
class Comparison:
    """The fitted twin compared with a recording.

    - `run`: the run of the fitted twin, without the camera's common error.
    - `camera`: the camera's common error.
    """

    run: Run
    camera: CameraError

    @property
    def reading(self) -> Run:
        """The run with the camera's common error added to its temperatures."""
        return replace(self.run, temperatures=self.run.temperatures + self.camera.offset[:, None])
