"""A schedule whose duty cycles reach the cells some time after their command.

Nothing but the inputs depends on time itself, so the whole grid of steps moves with the inputs:
steps stay fine behind every change, and temperatures are smooth in the delay.
"""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics import Twin
from ._interpolation import sample_weights, step_polynomials
from ._schedule import Schedule

FINEST, FIRST, GROWN = 2.0**-9, 2.0**-5, 16
BEFORE = np.diff([0.0, *np.geomspace(FINEST, FIRST, 5), *np.geomspace(FIRST, 1.0, GROWN + 1)[1:]])
"""Steps before the first command arrives, as parts of the delay: fine at first, when a plate that
did not start at rest changes fastest, then a quarter longer each, or samples between their ends
would be missed by a tenth of a kelvin where the delay is a minute."""


def has_own_delays(twin: Twin, drawn: Iterable[str]) -> bool:
    """Whether draws of these parameters have a delay each, not one for all or none."""
    delay = twin.wiring.delay
    return delay is not None and not delay.parameters.isdisjoint(drawn)


def delayed_schedule(schedule: Schedule, delay: Float[Array, ""], at_rest: bool) -> Schedule:
    """The same samples of the same experiment with duty cycles that arrive late.

    A recorded ambient, which is not late, is averaged over each step.

    **Arguments:**

    - `delay`: s, above 0.
    - `at_rest`: whether the first duty cycle has been held for ever, instead of none.
    """
    dtype = delay.dtype
    before = len(BEFORE)
    sizes = jnp.concatenate(
        [delay * jnp.asarray(BEFORE, dtype), jnp.asarray(schedule.sizes, dtype)]
    )
    size = jnp.concatenate([jnp.arange(before), before + jnp.asarray(schedule.size)])
    duty = jnp.asarray(schedule.duty, dtype)
    first = duty[:1] if at_rest else jnp.zeros_like(duty[:1])
    wait = jnp.asarray(step_polynomials([BEFORE, np.ones(1)])[:before], dtype)
    polynomials = jnp.asarray(schedule.polynomials, dtype)
    # Slopes, the odd ones, are per second.
    scale = jnp.stack([jnp.ones_like(delay), delay] * 3)
    steps = sizes[size]
    ends = jnp.cumsum(steps)
    starts = ends - steps
    times = jnp.asarray(schedule.times, dtype)
    step_of = jnp.clip(jnp.searchsorted(ends, times), 0, size.size - 1)
    # Some steps have no length (`_padding`): what is divided by it must not be 0 / 0.
    lengths = jnp.where(steps > 0, steps, 1.0)
    part = (times - starts[step_of]) / lengths[step_of]
    # One table for all draws, whatever their delay.
    weights = sample_weights(jnp.concatenate([wait, polynomials]), step_of, part)
    waiting = (step_of < before)[:, None]
    ambient = schedule.ambient
    if schedule.ambient_at is not None:
        held = jnp.asarray(schedule.ambient_at, dtype)
        summed = jnp.append(0.0, jnp.cumsum(held[:-1] * jnp.diff(times)))
        ambient = (jnp.interp(ends, times, summed) - jnp.interp(starts, times, summed)) / lengths
        # Steps that end behind the last sample.
        ambient = jnp.where(ends > times[-1], held[-1], ambient)
    return Schedule(
        times=schedule.times,
        sizes=sizes,
        size=size.astype(np.int32),
        duty=jnp.concatenate([jnp.repeat(first, before, axis=0), duty]),
        ambient=ambient,
        polynomials=jnp.concatenate([wait * scale[:, None], polynomials]),
        step_of=step_of.astype(np.int32),
        weights=weights * jnp.where(waiting, scale, 1.0),
        ambient_at=schedule.ambient_at,
    )
