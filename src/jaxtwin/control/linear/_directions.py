"""The directions in which cells move the temperatures of a plate: its mean and its uniformity."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True)
class Directions:
    r"""The singular value decomposition of the gain at rest, $G = U \Sigma V^T$.

    A duty along a column of `inputs` moves the channels along the same column of `outputs`, by
    `gains` kelvins (root of the sum of squares) per unit of duty.

    - `gains`: $\Sigma$, largest first, K per unit of duty.
    - `outputs`: $U$, `(outputs, directions)`. `inputs`: $V$, `(inputs, directions)`.
    - `mean_share`: the part of a direction's squared temperatures that all channels share. Near 1
      the direction moves the mean, near 0 the uniformity.
    - `duty_per_kelvin`: the duty (root of the sum of squares) for 1 K, root mean square over the
      channels.
    """

    gains: Float[np.ndarray, " directions"]
    outputs: Float[np.ndarray, "outputs directions"]
    inputs: Float[np.ndarray, "inputs directions"]
    mean_share: Float[np.ndarray, " directions"]
    duty_per_kelvin: Float[np.ndarray, " directions"]

    @property
    def names(self) -> tuple[str, ...]:
        """`"mean"` or `"uniformity"` for each direction, whichever has the larger part."""
        return tuple("mean" if share > 0.5 else "uniformity" for share in self.mean_share)

    @property
    def condition_number(self) -> float:
        """The ratio of the largest gain to the smallest."""
        return float(self.gains[0] / self.gains[-1])


def directions(gain: Float[np.ndarray, "outputs inputs"]) -> Directions:
    """Computes the directions of a gain. Each is signed such that temperatures rise on average."""
    outputs, gains, inputs = np.linalg.svd(gain, full_matrices=False)
    sign = np.where(outputs.sum(axis=0) < 0, -1.0, 1.0)
    return Directions(
        gains,
        outputs * sign,
        inputs.T * sign,
        outputs.sum(axis=0) ** 2 / len(outputs),
        np.sqrt(len(outputs)) / gains,
    )
