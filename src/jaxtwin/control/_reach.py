"""Checks before a loop is run: whether the rig can reach the references, and whether the controller
is fast enough."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from .._errors import ControlError
from ..physics import System, Twin
from ..simulation._modes import network_modes

LEVELS = np.linspace(-1, 1, 17)
"""Equal duty cycles that are tried: a cell cools best with less than full duty."""

MARGIN = 1e-6


def check_reach(
    system: System,
    weights: Float[np.ndarray, "outputs channels"],
    reference: Float[np.ndarray, "samples outputs"],
    times: Float[np.ndarray, " samples"],
    ambient: Float[np.ndarray, "rows substeps"],
) -> None:
    """Refuses references that no equal duty of all cells reaches at rest.

    **Raises:** `ControlError` that names the reference, its time and the reachable range.
    """
    reached = weights @ np.asarray(_steady_channels(system)).T
    lowest = reached.min(axis=1) + float(ambient.min())
    highest = reached.max(axis=1) + float(ambient.max())
    wrong = (reference < lowest - MARGIN) | (reference > highest + MARGIN)
    if not wrong.any():
        return
    sample, output = np.argwhere(wrong)[0]
    raise ControlError(
        f"references: expected {lowest[output]:.1f} to {highest[output]:.1f} degC, which the duty "
        f"can hold, got {reference[sample, output]:.1f} degC at {times[sample]:g} s"
    )


def check_sample_time(twin: Twin, sample_time_s: float) -> None:
    """Refuses a controller whose sample time is longer than the slowest time constant of the plate.

    **Raises:** `ControlError`.
    """
    slowest = float(_slowest_time_constant(twin))
    if sample_time_s > slowest:
        raise ControlError(
            f"sample_time_s: expected at most the rig's longest time constant, {slowest:.0f} s (a "
            f"tenth of it is usual), got {sample_time_s:g} s"
        )


@persistent_jit
def _steady_channels(system: System) -> Float[Array, "levels channels"]:
    """Steady rises of the channels above the surroundings under equal duty of all cells, K."""
    reference = jnp.asarray(system.ambient_temperature)
    cells = len(system.wiring.cold)

    def channels(level: Float[Array, ""]) -> Float[Array, " channels"]:
        duty = jnp.full(cells, level, reference.dtype)
        return system.channel_temperatures(system.steady_state(duty, reference))

    return jax.vmap(channels)(jnp.asarray(LEVELS, reference.dtype))


@persistent_jit
def _slowest_time_constant(twin: Twin) -> Float[Array, ""]:
    system = twin.system()
    reference = jnp.asarray(system.ambient_temperature)
    idle = jnp.zeros(len(system.wiring.cold), reference.dtype)
    return 1 / network_modes(system, idle, reference).rates[0]
