r"""The frequency response of a linear model, with its delay and lag exact:

$$G(j \omega) = \frac{C (j \omega I - A)^{-1} B + D}{1 + j \omega \tau} e^{-j \omega \theta}$$
"""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..._lapack import solve

if TYPE_CHECKING:
    from ._linear_model import LinearModel


# The number of frequencies whose matrices are in memory at the same time.
AT_ONCE = 256


def frequency_response(
    model: "LinearModel", omega: Float[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "frequency output input"]:
    """Computes the response of a model with NumPy numbers at frequencies, rad/s."""
    A, B, C, D = (np.asarray(matrix) for matrix in (model.A, model.B, model.C, model.D))
    unit = np.eye(len(A))
    parts = [omega[first : first + AT_ONCE] for first in range(0, len(omega), AT_ONCE)]
    moved = [np.linalg.solve(1j * part[:, None, None] * unit - A, B) for part in parts]
    response = C @ np.concatenate([np.zeros((0, *B.shape)), *moved]) + D
    driver = np.exp(-1j * omega * model.delay_s) / (1 + 1j * omega * model.lag_s)
    return response * driver[:, None, None]


@jax.jit
def traced_response(
    model: "LinearModel", omega: Float[Array, " frequency"]
) -> Complex[Array, "frequency output input"]:
    """Computes the response of a model inside JAX transformations."""
    A, B, C, D = (jnp.asarray(matrix) for matrix in (model.A, model.B, model.C, model.D))
    unit = jnp.eye(len(A), dtype=A.dtype)
    right = jnp.concatenate([B, jnp.zeros_like(B)])

    def at(frequency: Float[Array, ""]) -> Complex[Array, "output input"]:
        # A complex system is solved as a real one of twice the size.
        blocks = jnp.block([[-A, -frequency * unit], [frequency * unit, -A]])
        real, imaginary = jnp.split(solve(blocks, right), 2)
        response = C @ real + D + 1j * (C @ imaginary)
        late = jnp.exp(-1j * frequency * model.delay_s)
        return response * late / (1 + 1j * frequency * model.lag_s)

    return jax.vmap(at)(omega)
