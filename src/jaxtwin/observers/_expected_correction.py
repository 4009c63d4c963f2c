r"""The correction of a camera that is expected within a step.

A camera that corrects itself at equal intervals $I$ does so again, at a time $t$ after the last
correction, with the density $\sum_{k \ge 1} N(t; k I, s^2)$. Within a step it therefore does so
with the probability

$$p = \Phi\Big(\frac{t + \Delta t - k I}{s}\Big) - \Phi\Big(\frac{t - k I}{s}\Big),$$

where $k I$ is the expected time next to the step. A correction adds a jump $N(\mu, \sigma^2)$ to
each part of the common error that fades; a mixture of one and none has the mean $p \mu$ and the
variance $p (\sigma^2 + \mu^2) - p^2 \mu^2$, which are what the step adds.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._augmented_model import AugmentedModel

# The standard deviation $s$ of the time of a correction, as a part of the interval.
INTERVAL_SPREAD = 0.01

# A correction is due within this many standard deviations of its expected time.
DUE = 2.0


class Jump(NamedTuple):
    """What a correction adds to the state.

    - `mean`: the expected jump of each entry. `variance`: the variance of the jump.
    """

    mean: Float[Array, " state"]
    variance: Float[Array, " state"]


def expected_jump(model: AugmentedModel, since: Float[Array, ""], dt: Float[Array, ""]) -> Jump:
    """The jump that a step adds.

    **Arguments:**

    - `since`: the time from the last correction of the camera to the start of the step, s;
      infinite if no correction has been seen.
    - `dt`: the length of the step, s.
    """
    none = jnp.zeros(model.layout.size, dt.dtype)
    if model.interval is None:
        return Jump(none, none)
    is_known = jnp.isfinite(since)
    start = jnp.where(is_known, since, 0.0)
    number = _next(model.interval, start + 0.5 * dt)
    edges = (jnp.stack([start, start + dt]) / model.interval - number) / INTERVAL_SPREAD
    before, after = jax.scipy.special.ndtr(edges)
    probability = jnp.where(is_known, after - before, 0.0)
    mean = probability * model.noise.jump_mean
    square = jnp.asarray(model.noise.jump) ** 2 + jnp.asarray(model.noise.jump_mean) ** 2
    variance = probability * square - mean**2
    fading = model.layout.fading
    return Jump(none.at[fading].set(mean), none.at[fading].set(variance))


def is_due(interval: float | None, since: Float[Array, ""]) -> Bool[Array, ""]:
    """Whether a correction is expected about now, so long after the last one."""
    if interval is None:
        return jnp.zeros((), bool)
    known = jnp.where(jnp.isfinite(since), since, 0.0)
    return jnp.abs(known / interval - _next(interval, known)) < DUE * INTERVAL_SPREAD


def _next(interval: float, since: Float[Array, ""]) -> Float[Array, ""]:
    """The number of the expected correction that is nearest."""
    return jnp.maximum(jnp.round(since / interval), 1.0)
