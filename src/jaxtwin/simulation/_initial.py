"""Node temperatures at the start of a run."""

from typing import Literal, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from .._celsius import ZERO_CELSIUS
from .._errors import SimulationError
from ..physics import System, Twin

Initial = Literal["steady"] | float | ArrayLike | None
"""Initial temperatures as a user gives them. None: those of the rig. "steady": the steady state
under the first input. A number: a uniform temperature, degC. An array `(nodes,)`: the temperature
of each node, in the order of `twin.netlist.nodes`, degC."""


CheckedInitial: TypeAlias = Literal["steady"] | Float[Array | np.ndarray, " starts"] | None
"""Checked initial temperatures: absolute, K, a temperature for each node or a single temperature
for all."""


def initial_temperatures(
    system: System,
    initial: CheckedInitial,
    duty: Float[Array | np.ndarray, " cells"],
    reference: Float[Array, ""],
) -> Float[Array, " nodes"]:
    """The absolute temperatures of the nodes at the start, K, from the result of
    `checked_initial`."""
    if initial is None:
        return system.initial_temperature
    if isinstance(initial, str):
        return reference + system.steady_state(jnp.asarray(duty, reference.dtype), reference)
    return jnp.broadcast_to(jnp.asarray(initial, reference.dtype), system.capacitance.shape)


def checked_initial(twin: Twin, initial: Initial) -> CheckedInitial:
    """Checks initial temperatures.

    **Raises:** `SimulationError` for another word, a wrong shape, or numbers that are not finite or
    below absolute zero.
    """
    if initial is None:
        return None
    if isinstance(initial, str) and initial == "steady":
        return "steady"
    nodes = len(twin.netlist.nodes)
    expected = f'None, "steady", a number or an array of {nodes} node temperatures in degC'
    if isinstance(initial, str):
        raise SimulationError(f"initial: expected {expected}, got {initial!r}")
    try:
        values = np.asarray(initial)
    except ValueError:  # rows of different lengths
        values = np.array(None)
    if values.dtype.kind not in "iuf":
        raise SimulationError(f"initial: expected {expected}, got {initial!r}")
    if values.shape not in ((), (nodes,)) or not np.isfinite(values).all():
        raise SimulationError(
            f"initial: expected {expected}, got shape {values.shape} with {values.tolist()}"
        )
    kelvin = np.atleast_1d(values.astype(float)) + ZERO_CELSIUS
    if kelvin.min() < 0:
        raise SimulationError(
            f"initial: expected {-ZERO_CELSIUS:g} degC and above, got "
            f"{kelvin.min() - ZERO_CELSIUS:g} degC"
        )
    return kelvin


def keeps_symmetry(initial: CheckedInitial) -> bool:
    """Whether equal nodes have equal initial temperatures, so that a lumped system is
    sufficient."""
    return initial is None or isinstance(initial, str) or initial.size == 1
