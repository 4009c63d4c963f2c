"""PWM counts, as a controller writes them, to duty cycles."""

import numpy as np
from jaxtyping import Float

from ._checks import WrongSampleError


def duty_from_counts(
    pwm: Float[np.ndarray, "times cells"], counts: int, polarity: int
) -> Float[np.ndarray, "times cells"]:
    """Duty cycles, positive where the plate is heated.

    **Arguments:**

    - `pwm`: -counts to counts, `(times, cells)`.
    - `counts`: counts of full duty.
    - `polarity`: 1 where positive counts heat the plate, -1 where they cool it.

    **Returns:**

    Duty cycles `(times, cells)`, -1 to 1. What is not finite stays so.

    **Raises:**

    `RecordingError` that names the cell and the sample of a count out of range.
    """
    outside = np.argwhere(np.abs(pwm) > counts)
    if outside.size:
        k, cell = outside[0]
        raise WrongSampleError(
            f"PWM of cell {cell + 1} is {pwm[k, cell]:g} at sample {k} (counted from 0); "
            f"allowed is {-counts} to {counts} counts",
            int(k),
        )
    return polarity * pwm / counts
