r"""The frequency response of a linear model, with its delay and lag exact:

$$G(j \omega) = \frac{C (j \omega I - A)^{-1} B + D}{1 + j \omega \tau} e^{-j \omega \theta}$$

In discrete time $z = e^{j \omega T_s}$ stands in place of $j \omega$, and delay and lag are states.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..._lapack import solve

if TYPE_CHECKING:
    from ._state_space import StateSpace


@final
@dataclass(frozen=True)
class Directions:
    r"""The singular value decomposition of the DC gain, $G = U \Sigma V^T$.

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


# The number of frequencies whose matrices are in memory at the same time.
AT_ONCE = 256


def frequency_response(
    model: "StateSpace", omega: Float[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "frequency output input"]:
    """Computes the response of a model with NumPy numbers at frequencies, rad/s."""
    A, B, C, D = (np.asarray(matrix) for matrix in (model.A, model.B, model.C, model.D))
    unit, argument = np.eye(len(A)), 1j * omega
    if model.sample_time_s is not None:
        argument = np.exp(argument * model.sample_time_s)
    parts = [argument[first : first + AT_ONCE] for first in range(0, len(omega), AT_ONCE)]
    moved = [np.linalg.solve(part[:, None, None] * unit - A, B) for part in parts]
    response = C @ np.concatenate([np.zeros((0, *B.shape)), *moved]) + D
    driver = np.exp(-1j * omega * model.delay_s) / (1 + 1j * omega * model.lag_s)
    return response * driver[:, None, None]


@jax.jit
def traced_response(
    model: "StateSpace", omega: Float[Array, " frequency"]
) -> Complex[Array, "frequency output input"]:
    """Computes the response of a model inside JAX transformations."""
    A, B, C, D = (jnp.asarray(matrix) for matrix in (model.A, model.B, model.C, model.D))
    unit = jnp.eye(len(A), dtype=A.dtype)
    right = jnp.concatenate([B, jnp.zeros_like(B)])

    def at(frequency: Float[Array, ""]) -> Complex[Array, "output input"]:
        # A complex system is solved as a real one of twice the size.
        x, y = jnp.zeros_like(frequency), frequency
        if model.sample_time_s is not None:
            angle = frequency * model.sample_time_s
            x, y = jnp.cos(angle), jnp.sin(angle)
        blocks = jnp.block([[x * unit - A, -y * unit], [y * unit, x * unit - A]])
        real, imaginary = jnp.split(solve(blocks, right), 2)
        response = C @ real + D + 1j * (C @ imaginary)
        late = jnp.exp(-1j * frequency * model.delay_s)
        return response * late / (1 + 1j * frequency * model.lag_s)

    return jax.vmap(at)(omega)
