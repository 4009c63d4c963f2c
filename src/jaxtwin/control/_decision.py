"""The decision of a controller on a live rig at a sample."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Decision(NamedTuple):
    """A sample of a controller on a live rig.

    - `time`: the time since the run began, in that of the rig, s.
    - `reference`, `measurement`: reference and measurement of each output, degC.
    - `duty`: the duty of each cell until the next sample, -1 to 1.
    """

    time: float
    reference: Float[np.ndarray, " outputs"]
    measurement: Float[np.ndarray, " outputs"]
    duty: Float[np.ndarray, " cells"]
