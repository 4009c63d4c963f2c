"""Node temperatures at the start of a run."""

from collections.abc import Mapping
from typing import Literal, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from .._arguments import finite_number
from .._celsius import ZERO_CELSIUS, is_probably_kelvin
from .._jax_settings import is_traced
from .._name_suggestions import unknown_name
from ..errors import JaxtwinError, SimulationError
from ..physics import System, Twin

# Initial temperatures as a user gives them. None: those of the rig. "steady": the steady state
# under the first input. A number: a uniform temperature, degC. An array `(nodes,)`: the temperature
# of each node, in the order of `twin.netlist.nodes`, degC. Names of nodes -> degC: these nodes,
# while the others begin as the rig says.
Initial = Literal["steady"] | float | ArrayLike | Mapping[str, float | int] | None


# Checked initial temperatures: absolute, K, a temperature for each node or a single temperature for
# all. NaN stands for that of the rig.
CheckedInitial: TypeAlias = Literal["steady"] | Float[Array | np.ndarray, " starts"] | None


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
    given = jnp.broadcast_to(jnp.asarray(initial, reference.dtype), system.capacitance.shape)
    return jnp.where(jnp.isnan(given), system.initial_temperature, given)


def checked_initial(twin: Twin, initial: Initial) -> CheckedInitial:
    """Checks initial temperatures.

    **Raises:** `SimulationError` for another word, the name of an unknown node, a wrong shape, or
    numbers that are not finite or below absolute zero.
    """
    if initial is None:
        return None
    if isinstance(initial, str) and initial == "steady":
        return "steady"
    nodes = len(twin.netlist.nodes)
    if isinstance(initial, Mapping) and initial:
        return _of_nodes(twin, initial)
    expected = (
        f'None, "steady", a number, an array of {nodes} node temperatures in degC, or names of '
        "nodes -> degC"
    )
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
    check_celsius("initial", kelvin - ZERO_CELSIUS, twin, SimulationError)
    return kelvin


def check_celsius(
    where: str, temperatures: Float[np.ndarray, "..."], twin: Twin, error: type[JaxtwinError]
) -> None:
    """Refuses temperatures at the start that seem to be in kelvin.

    **Raises:** `error` with the value in degC.
    """
    if is_traced(twin):
        return
    room = float(twin.rig.ambient_temperature.evaluate(twin.numbers_si)) - ZERO_CELSIUS
    highest = float(temperatures.max())
    if is_probably_kelvin(highest, room):
        raise error(
            f"{where}: expected degC, got {highest:g} degC in a room of {room:.0f} degC; is it in "
            f"K, {highest - ZERO_CELSIUS:.1f} degC?"
        )


def _of_nodes(twin: Twin, given: Mapping[str, float | int]) -> Float[np.ndarray, " nodes"]:
    """The temperatures of all nodes from those of some; NaN for the others."""
    kelvin = np.full(len(twin.netlist.nodes), np.nan)
    for name, celsius in given.items():
        if name not in twin.netlist.index:
            raise SimulationError(f"initial: {unknown_name('node', name, twin.netlist.index)}")
        value = finite_number(f"initial: {name}", celsius, SimulationError)
        if value < -ZERO_CELSIUS:
            raise SimulationError(
                f"initial: {name}: expected {-ZERO_CELSIUS:g} degC and above, got {value:g} degC"
            )
        check_celsius(f"initial: {name}", np.array(value), twin, SimulationError)
        kelvin[twin.netlist.index[name]] = value + ZERO_CELSIUS
    return kelvin


def keeps_symmetry(initial: CheckedInitial) -> bool:
    """Whether equal nodes have equal initial temperatures, so that a lumped system is
    sufficient."""
    return initial is None or isinstance(initial, str) or initial.size == 1
