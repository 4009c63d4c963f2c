r"""The state of a rig at each sample, given all readings: those before it and those after it.

This is the modified Bryson-Frazier smoother (G. J. Bierman, Factorization Methods for Discrete
Sequential Estimation, 1977, chapter 10): a vector $\lambda$ and a matrix $\Lambda$ go backwards
through the linearised steps and corrections of the filter,

$$\lambda \leftarrow (I - K H)^T \lambda - H^T w, \qquad
\Lambda \leftarrow (I - K H)^T \Lambda (I - K H) + H^T H$$

at the readings of a sample with whitened innovations $w$, where $H$ and the gain $K$ are those of
the whitened readings (`_gaussian`); $\lambda \leftarrow F^T \lambda$ and
$\Lambda \leftarrow F^T \Lambda F$ at each step. The state then is $x - P \lambda$ with the
covariance $P - P \Lambda P$. No covariance is inverted, so that states without any noise, such as
the lag of a driver, need no care.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from ._filter_run import FilterSamples
from ._gaussian import Correction, symmetric
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._moments import Moments, moments

Adjoint = tuple[Float[Array, " state"], Float[Array, "state state"]]


@persistent_jit
def smoothed(kalman: ExtendedKalmanFilter, states: KalmanState, samples: FilterSamples) -> Moments:
    """The moments of the state at each sample, given all readings.

    **Arguments:**

    - `states`: the filter's states after each sample.
    """

    def take(
        later: Adjoint, at: tuple[KalmanState, KalmanState, FilterSamples]
    ) -> tuple[Adjoint, Moments]:
        before, after, sample = at
        vector, matrix = later
        mean = after.mean - after.covariance @ vector
        covariance = after.covariance - after.covariance @ matrix @ after.covariance
        result = moments(kalman.model, mean, covariance)
        predicted, step = kalman.linearised_step(before, sample.duty, sample.dt, sample.levels)
        correction = kalman.correction(
            predicted, sample.readings, jnp.isfinite(sample.readings), sample.ambient
        )
        vector, matrix = _before_readings(later, correction)
        matrix = step.slope.T @ matrix @ step.slope
        return (step.slope.T @ vector, symmetric(matrix)), result

    # The first sample is corrected as well, but what is before it is of no interest.
    before = jax.tree.map(lambda leaf: jnp.concatenate([leaf[:1], leaf[:-1]]), states)
    size = states.mean.shape[1]
    none = jnp.zeros(size, states.mean.dtype), jnp.zeros((size, size), states.mean.dtype)
    _, result = jax.lax.scan(take, none, (before, states, samples), reverse=True)
    return result


def _before_readings(after: Adjoint, correction: Correction) -> Adjoint:
    """The adjoint before the readings of a sample, given that after them."""
    vector, matrix = after
    gain, slope = correction.gain, correction.slope
    left = jnp.eye(len(vector)) - gain @ slope
    vector = left.T @ vector - slope.T @ correction.whitened
    return vector, left.T @ matrix @ left + slope.T @ slope
