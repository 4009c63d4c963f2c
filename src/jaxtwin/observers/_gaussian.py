r"""The algebra of the Kalman filter: a normal distribution that steps predict and readings update.

The innovations $e$ of the readings $H x$ have the covariance $S = H P H^T + R = L L^T$. They are
whitened: $w = L^{-1} e$ are independent and of variance 1, each what those before it do not say.
With $W = L^{-1} H P$ the optimal gain of the whitened innovations is $W^T$. For any other gain $K$
Joseph's form of the covariance is

$$P - K W - W^T K^T + K K^T = P - W^T W + (K - W^T) (K - W^T)^T.$$

A reading that is missing has a row of zeros in $H$ and the variance 1, so that shapes stay the
same.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

LOG_TWO_PI = 1.8378770664093453

# An innovation of this many standard deviations is not noise.
CAUTION_SIGMAS = 4.0


class Gaussian(NamedTuple):
    """A normal distribution."""

    mean: Float[Array, " state"]
    covariance: Float[Array, "state state"]


class GaussianUpdate(NamedTuple):
    """The state after readings, and what they said.

    - `state`: the state after them.
    - `whitened`: the whitened innovations, 0 for readings that were left out.
    - `spreads`: the standard deviation of each innovation, given those before it; 1 for readings
      that were left out.
    - `gain`: the derivative of the state with respect to the whitened innovations. `slope`: that of
      the whitened readings with respect to the state.
    - `log_densities`: the logarithm of the probability density of each reading, given those before
      it; 0 for readings that were left out.
    """

    state: Gaussian
    whitened: Float[Array, " readings"]
    spreads: Float[Array, " readings"]
    gain: Float[Array, "state readings"]
    slope: Float[Array, "readings state"]
    log_densities: Float[Array, " readings"]


def time_update(
    state: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "driven driven"],
    decay: Float[Array, " others"],
    noise: Float[Array, "state state"],
) -> Gaussian:
    """The distribution after a step, linearised at its mean.

    **Arguments:**

    - `mean`: the mean after the step.
    - `slope`: the Jacobian of the transition of the first entries, which are coupled.
    - `decay`: the factors of the others, which decay by themselves.
    - `noise`: the covariance of the noise that the step adds.
    """
    before, driven = state.covariance, len(slope)
    first = slope @ before[:driven, :driven] @ slope.T
    across = slope @ before[:driven, driven:] * decay
    others = before[driven:, driven:] * jnp.outer(decay, decay)
    covariance = jnp.block([[first, across], [across.T, others]])
    return Gaussian(mean, symmetric(covariance + noise))


def measurement_update(
    state: Gaussian,
    innovation: Float[Array, " readings"],
    slope: Float[Array, "readings state"],
    variance: Float[Array, " readings"],
    mask: Bool[Array, " readings"],
    parameter_entries: slice,
) -> GaussianUpdate:
    """The distribution after readings.

    A reading that is more than `CAUTION_SIGMAS` standard deviations from what was expected has a
    cause that the model does not know. It moves the parameters no farther than a reading at that
    distance would, with a gain that is smaller than the optimal one.

    **Arguments:**

    - `innovation`: the readings less the expected ones; anything where `mask` is false.
    - `slope`: the derivatives of the readings with respect to the state.
    - `variance`: the variance of the noise of each reading.
    - `mask`: the readings that count.
    - `parameter_entries`: the entries of the state that are parameters of the rig.
    """
    innovation = jnp.where(mask, innovation, 0.0)
    slope = jnp.where(mask[:, None], slope, 0.0)
    cross = slope @ state.covariance
    root = jnp.linalg.cholesky(cross @ slope.T + jnp.diag(jnp.where(mask, variance, 1.0)))

    def whiten(right: Array) -> Array:
        return jax.scipy.linalg.solve_triangular(root, right, lower=True)

    columns = whiten(jnp.concatenate([cross, innovation[:, None]], axis=1))
    optimal, whitened = columns[:, :-1].T, columns[:, -1]
    caution = CAUTION_SIGMAS / jnp.maximum(jnp.abs(whitened), CAUTION_SIGMAS)
    gain = optimal.at[parameter_entries].multiply(caution)
    missed = (gain - optimal)[parameter_entries]  # the other rows are 0
    covariance = state.covariance - optimal @ optimal.T
    covariance = covariance.at[parameter_entries, parameter_entries].add(missed @ missed.T)
    spreads = jnp.diagonal(root)
    density = -0.5 * (whitened**2 + LOG_TWO_PI) - jnp.log(spreads)
    return GaussianUpdate(
        state=Gaussian(state.mean + gain @ whitened, symmetric(covariance)),
        whitened=whitened,
        spreads=spreads,
        gain=gain,
        slope=whiten(slope),
        log_densities=jnp.where(mask, density, 0.0),
    )


def symmetric(covariance: Float[Array, "state state"]) -> Float[Array, "state state"]:
    """A covariance without the rounding by which it differs from its transpose: processors that
    multiply and add at once round both sides differently."""
    return (covariance + covariance.T) / 2
