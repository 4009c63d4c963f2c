"""The algebra of the Kalman filter: a normal distribution that is moved, and corrected by readings.

Readings are taken one after the other, which gives the same as all at once (their noise is
independent), needs no inverse of a matrix, and lets each be left out by itself. Covariances are
updated in Joseph's form, which stays symmetric and positive in spite of rounding.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

LOG_TWO_PI = 1.8378770664093453

SURPRISE = 4.0
"""An innovation of this many standard deviations is not noise."""


class Gaussian(NamedTuple):
    """A normal distribution."""

    mean: Float[Array, " state"]
    covariance: Float[Array, "state state"]


class Correction(NamedTuple):
    """The state after readings, and what they said.

    - `state`: the state after them.
    - `whitened`: the innovations, each less what those before it say of it and divided by its
      standard deviation: independent and of variance 1 if the model is right; 0 for readings that
      were left out.
    - `spreads`: these standard deviations. `gains`: the gains, 0 for readings that were left out.
    - `log_densities`: the logarithm of the probability density of each reading, given those before
      it; 0 for readings that were left out.
    """

    state: Gaussian
    whitened: Float[Array, " readings"]
    spreads: Float[Array, " readings"]
    gains: Float[Array, "readings state"]
    log_densities: Float[Array, " readings"]


def moved(
    state: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "state state"],
    noise: Float[Array, "state state"],
) -> Gaussian:
    """The distribution after a step, linearised at its mean."""
    return Gaussian(mean, symmetric(slope @ state.covariance @ slope.T + noise))


def corrected(
    state: Gaussian,
    innovation: Float[Array, " readings"],
    slope: Float[Array, "readings state"],
    variance: Float[Array, " readings"],
    mask: Bool[Array, " readings"],
    is_cautious: Bool[Array, " state"],
) -> Correction:
    """The distribution after readings.

    A reading that is more than `SURPRISE` standard deviations from what was expected has a cause
    that the model does not know. It moves the entries that `is_cautious` marks no farther than one
    of that many standard deviations, with a gain that is smaller than the optimal one, for which
    Joseph's form holds as well.

    **Arguments:**

    - `innovation`: the readings less the expected ones; anything where `mask` is false.
    - `slope`: the derivatives of the readings with respect to the state.
    - `variance`: the variance of the noise of each reading.
    - `mask`: the readings that count.
    - `is_cautious`: the entries that say how the rig is made, not what it is doing.
    """
    innovation = jnp.where(mask, innovation, 0.0)
    start = state.mean

    def take(state: Gaussian, reading: tuple[Array, ...]) -> tuple[Gaussian, tuple[Array, ...]]:
        difference, row, noise, counts = reading
        error = difference - row @ (state.mean - start)
        cross = state.covariance @ row
        spread = row @ cross + noise
        surprise = jnp.abs(error) / jnp.sqrt(spread)
        caution = jnp.where(is_cautious, SURPRISE / jnp.maximum(surprise, SURPRISE), 1.0)
        gain = jnp.where(counts, caution * cross / spread, 0.0)
        # (I - k h) P (I - k h)' + k r k'
        left = jnp.outer(gain, cross)
        covariance = state.covariance - left - left.T + spread * jnp.outer(gain, gain)
        whitened = jnp.where(counts, error / jnp.sqrt(spread), 0.0)
        density = -0.5 * (whitened**2 + jnp.log(spread) + LOG_TWO_PI)
        found = whitened, jnp.sqrt(spread), gain, jnp.where(counts, density, 0.0)
        return Gaussian(state.mean + gain * error, symmetric(covariance)), found

    state, found = jax.lax.scan(take, state, (innovation, slope, variance, mask))
    return Correction(state, *found)


def symmetric(covariance: Float[Array, "state state"]) -> Float[Array, "state state"]:
    """A covariance without the rounding by which it differs from its transpose: processors that
    multiply and add at once round both sides differently."""
    return (covariance + covariance.T) / 2
