"""The temperature of the surroundings during a run: recorded, or the rig's own, which may drift."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics import System
from ._schedule import Schedule


def reference_temperature(system: System, schedule: Schedule) -> Float[Array, ""]:
    """What deviations are counted from: the ambient at the start, recorded or the rig's, K."""
    if schedule.ambient is None:
        return system.ambient_temperature
    return jnp.asarray(schedule.ambient[0], system.capacitance.dtype)


def ambient_of_steps(system: System, schedule: Schedule) -> Float[Array, "steps *stages"]:
    """The ambient's deviation from the reference during each step, K; where it drifts, at the
    start, in the middle and at the end of each."""
    dtype = system.capacitance.dtype
    steps = jnp.asarray(schedule.sizes, dtype)[schedule.size]
    if schedule.ambient is not None:
        return jnp.asarray(schedule.ambient, dtype) - reference_temperature(system, schedule)
    if system.ambient_drift is None:
        return jnp.zeros(steps.size, dtype)
    stages = jnp.cumsum(steps)[:, None] - steps[:, None] * jnp.array([1.0, 0.5, 0.0], dtype)
    return system.ambient_drift * stages


def ambient_of_samples(
    system: System, schedule: Schedule, which: slice = slice(None)
) -> Float[Array, "times 1"] | float:
    """The ambient's deviation from the reference at the samples, or at some, K."""
    dtype = system.capacitance.dtype
    if schedule.ambient_at is not None:
        at = jnp.asarray(schedule.ambient_at, dtype)[which]
        return (at - reference_temperature(system, schedule))[:, None]
    if system.ambient_drift is None:
        return 0.0
    return (system.ambient_drift * jnp.asarray(schedule.times, dtype)[which])[:, None]
