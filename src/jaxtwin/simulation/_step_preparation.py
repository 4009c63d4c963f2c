"""The numbers that a `Stepper` computes once for its step size: the parts of a step, which are
divided by the arrivals of commands, and their factors in the modes of the network."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit_unoptimised
from .._jax_settings import is_traced
from ..errors import SimulationError
from ..physics import System
from ._drive import checked_longest_delay
from ._exponential import ModalField, StepFactors, step_factors
from ._modes import LossShapes, Modes, network_modes
from ._refinement import STABILITY_LIMIT, remainder_gain

# A delay counts as a multiple of the step size if the relative difference is below this.
MULTIPLE_TOLERANCE = 1e-9


# The most commands that a state holds on their way.
MAX_COMMANDS = 1_000_000


class ModalSteps(NamedTuple):
    """The fields of a `Stepper` that depend on the modes in which it steps, and the stability
    number of its steps over all duty cycles."""

    factors: StepFactors
    field: ModalField
    losses: LossShapes | None
    half_decay: Float[Array, " modes"]
    half: Float[Array, " modes"]
    stability: Float[Array, ""]


@persistent_jit_unoptimised
def prepare_steps(
    system: System, step_size: Float[Array, ""], is_whole_delay: bool
) -> tuple[Int[Array, ""], Float[Array, " parts"], ModalSteps]:
    """Computes the delay in whole steps, the parts of a step, s, and the steps in the modes of the
    network with idle cells."""
    modes = network_modes(system, None, jnp.asarray(system.ambient_temperature))
    if system.delay is None:
        whole, sizes = jnp.asarray(0), step_size[None]
    elif is_whole_delay:
        whole, sizes = jnp.round(system.delay / step_size).astype(int), step_size[None]
    else:
        # Rounding must not split a delay of n steps into n - 1 steps and a remainder of a step.
        whole = jnp.floor(system.delay / step_size * (1 + MULTIPLE_TOLERANCE)).astype(int)
        rest = jnp.maximum(system.delay - whole * step_size, 0.0)
        sizes = jnp.stack([rest, step_size - rest])
    return whole, sizes, steps_in_modes(system, modes, step_size, sizes)


def steps_in_modes(
    system: System, modes: Modes, step_size: Float[Array, ""], sizes: Float[Array, " parts"]
) -> ModalSteps:
    """Computes the arrays that the steps of a network need in these modes."""
    reference = jnp.asarray(system.ambient_temperature)
    idle = jnp.zeros(len(system.wiring.cold), reference.dtype)
    levels = jnp.stack([idle - 1, idle, idle + 1])
    stability = remainder_gain(system, modes, levels, reference, step_size)
    linear = eqx.tree_at(lambda m: m.losses, modes, None, is_leaf=lambda leaf: leaf is None)
    field = ModalField.of(system, linear, reference)
    of_step = step_factors(modes.rates, step_size)
    factors = step_factors(modes.rates, sizes)
    return ModalSteps(factors, field, modes.losses, of_step.half_decay, of_step.half, stability)


def check_stable(where: str, step_size: float, stability: Float[Array, ""]) -> None:
    """Refuses steps that are not stable; a stability number that JAX traces is not checked.

    **Raises:** `SimulationError`.
    """
    if not is_traced(stability) and not float(stability) <= STABILITY_LIMIT:
        raise SimulationError(
            f"{where}: step_size: expected steps with a stability number of at most "
            f"{STABILITY_LIMIT:g}, got {step_size:g} s with {float(stability):.2g}; take shorter "
            "steps"
        )


def is_multiple(delay: Float[Array | np.ndarray, ""] | float | None, step_size: float) -> bool:
    """Whether a driver's delay is a whole number of steps; False if JAX traces it."""
    if delay is None:
        return True
    if is_traced(delay):
        return False
    steps = float(delay) / step_size
    return abs(steps - round(steps)) <= MULTIPLE_TOLERANCE * max(steps, 1.0)


def queue_length(
    delay: Float[Array, ""] | None, step_size: float, longest_delay: float | int | None
) -> int:
    """Computes the number of commands in a state: that of this step, and one for each step of the
    delay, rounded up to a power of two so that a delay of similar size needs no new compilation.

    **Raises:** `SimulationError` if the delay is traced by JAX and `longest_delay` is missing, if
    the delay is longer than `longest_delay`, or if there are too many steps in it.
    """
    if delay is None:
        return 0
    longest = checked_longest_delay("Stepper: longest_delay", longest_delay, delay, SimulationError)
    if longest > MAX_COMMANDS * step_size:
        raise SimulationError(
            f"Stepper: step_size: expected at least {longest / MAX_COMMANDS:g} s, as a delay of "
            f"{longest:g} s holds a command for each step, got {step_size:g}; is it in another "
            "unit?"
        )
    return 1 << (int(longest / step_size) + 1).bit_length()
