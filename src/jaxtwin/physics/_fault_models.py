r"""Faults of a rig as changes of its equations: each model makes a function `System -> System`.

The virtual rig, the hypotheses of a diagnosis and tests use the same models. They are pure, and
differentiable in the size of the fault.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from .._errors import SimulationError
from .._name_suggestions import unknown_name
from ..rig import Registration, Rig, Value, ZoneSensor
from ._registration import RegisteredZones
from ._system import System
from ._twin import Twin

Fault: TypeAlias = Callable[[System], System]
"""The equations of a rig -> those of the same rig with a fault."""

FaultModel: TypeAlias = Callable[[Twin, str, Float[ArrayLike, ""]], Fault]
"""A twin, the part of its rig that is faulty, and the size of the fault -> the fault."""

INTERRUPTED = 1e9
"""The resistance of a circuit that is interrupted, ohm."""


def loosened_contact(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The contact resistances between a cell and what it touches are `factor` times as large; or
    all resistances between a heater with a heat capacity and other nodes.

    **Raises:** `SimulationError` if the rig has no such cell; so do the other models of cells.
    """
    rig = twin.rig
    apart = [heater.name for heater in rig.heaters if heater.node == heater.name]
    _number("cell", cell, (*_cells(rig), *apart))
    number = rig.driven.index(cell)

    def fault(system: System) -> System:
        cold, hot = int(system.wiring.cold[number]), int(system.wiring.hot[number])
        others = np.setdiff1d(np.arange(len(system.capacitance)), [cold, hot])
        matrix = system.conductance
        change = matrix[cold, others] * (1 / factor - 1)  # of -G_ij, W/K
        matrix = matrix.at[cold, others].add(change).at[others, cold].add(change)
        matrix = matrix.at[cold, cold].add(-change.sum()).at[others, others].add(-change)
        return eqx.tree_at(lambda s: s.conductance, system, matrix)

    return fault


def open_circuit(twin: Twin, cell: str, _: Float[ArrayLike, ""] = 1.0) -> Fault:
    """The circuit of a cell or heater is interrupted: no current flows through it."""
    number = _number("cell", cell, twin.rig.driven)

    def fault(system: System) -> System:
        resistance = jnp.asarray(system.module.electrical_resistance).at[number].set(INTERRUPTED)
        return eqx.tree_at(lambda s: s.module.electrical_resistance, system, resistance)

    return fault


def aged_cell(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The electrical resistance of a cell or heater is `factor` times as large, as by cracks in its
    solder after many thermal cycles."""
    number = _number("cell", cell, twin.rig.driven)

    def fault(system: System) -> System:
        resistance = jnp.asarray(system.module.electrical_resistance).at[number].multiply(factor)
        return eqx.tree_at(lambda s: s.module.electrical_resistance, system, resistance)

    return fault


def blocked_sink(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The resistances from the far side of a cell, and from what is mounted there, to the
    surroundings and to coolants are `factor` times as large. Cells that share a sink share the
    fault."""
    number = _number("cell", cell, _cells(twin.rig))

    def fault(system: System) -> System:
        behind = _behind(system, number)
        ambient = system.ambient_conductance
        lost = jnp.where(behind, ambient * (1 - 1 / factor), 0.0)
        changed = [ambient - lost]
        parts = [lambda s: s.ambient_conductance]
        if system.reservoirs is not None:
            held = system.reservoirs.conductance
            less = jnp.where(behind, held * (1 - 1 / factor), 0.0)
            changed.append(held - less)
            parts.append(lambda s: s.reservoirs.conductance)
            lost = lost + less.sum(axis=0)
        changed.append(system.conductance - jnp.diag(lost))
        parts.append(lambda s: s.conductance)
        return eqx.tree_at(lambda s: [part(s) for part in parts], system, changed)

    return fault


def weak_supply(twin: Twin, part: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The voltage of the supply, `part` "supply", is `factor` of what it was. So is that of the
    supplies of heaters of a given power."""
    _number("part", part, ("supply",))

    def fault(system: System) -> System:
        bridge = system.bridge
        weak = [jnp.asarray(v) * factor for v in (bridge.supply_voltage, bridge.own_voltage)]
        return eqx.tree_at(lambda s: [s.bridge.supply_voltage, s.bridge.own_voltage], system, weak)

    return fault


def gained_channel(twin: Twin, channel: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The gain of a channel is `factor` times as large, as by another emissivity of its zone.

    **Raises:** `SimulationError` if the rig has no such channel.
    """
    number = _number("channel", channel, twin.channels)
    return lambda system: eqx.tree_at(
        lambda s: s.gain, system, jnp.asarray(system.gain).at[number].multiply(factor)
    )


def covered_channel(twin: Twin, channel: str, share: Float[ArrayLike, ""]) -> Fault:
    """A share of what a channel sees, 0 to 1, is covered by something as warm as the
    surroundings."""
    return gained_channel(twin, channel, 1 - share)


def moved_camera(twin: Twin, axis: str, shift: Float[ArrayLike, ""]) -> Fault:
    """The zones of the camera's picture lie `shift` (m) farther along the plate's `axis`, "x" or
    "y".

    **Raises:** `SimulationError` for another axis, or for a rig whose channels are not all zones of
    a picture.
    """
    across = _number("axis", axis, ("x", "y"))
    rig = twin.rig
    sees_zones = all(isinstance(channel.sensor, ZoneSensor) for channel in rig.channels)
    if rig.camera is None or not sees_zones:
        raise SimulationError(
            f"{rig.name}: fault: expected a rig whose channels are zones of a camera's picture"
        )
    zero = Value(0.0)
    zones = RegisteredZones(
        rig, rig.camera.registration or Registration(zero, zero, Value(1.0), zero)
    )
    moved = (0.0, shift) if across else (shift, 0.0)

    def fault(system: System) -> System:
        values = twin.values_si
        change = zones.element_weights(values, moved) - zones.element_weights(values)
        weights = jnp.asarray(system.channel_weights)
        weights = weights.at[:, system.wiring.rig_elements].add(change.astype(weights.dtype))
        return eqx.tree_at(
            lambda s: s.moved_weights, system, weights, is_leaf=lambda leaf: leaf is None
        )

    return fault


FAULT_MODELS: Mapping[str, FaultModel] = {
    "loosen": loosened_contact,
    "fail": open_circuit,
    "age": aged_cell,
    "block": blocked_sink,
    "weaken": weak_supply,
    "gain": gained_channel,
    "cover": covered_channel,
    "move": moved_camera,
}
"""The models by the words of `jaxtwin virtual-rig --faults`; a new model is entered here."""


def _cells(rig: Rig) -> tuple[str, ...]:
    return tuple(cell.name for cell in rig.cells)


def _number(kind: str, name: str, names: tuple[str, ...]) -> int:
    """The number of a named part.

    **Raises:** `SimulationError` that lists the names.
    """
    if name not in names:
        raise SimulationError(f"fault: {unknown_name(kind, name, names)}")
    return names.index(name)


def _behind(system: System, cell: int) -> Bool[np.ndarray, " nodes"]:
    """Whether heat reaches a node from the far side of a cell without passing the plate or the near
    side of a cell."""
    wiring = system.wiring
    nodes = len(system.capacitance)
    linked = np.zeros((nodes, nodes), bool)
    a, b = wiring.pairs
    linked[a, b] = linked[b, a] = True
    free = np.ones(nodes, bool)
    free[: wiring.elements] = False
    free[wiring.cold] = False
    behind = np.zeros(nodes, bool)
    behind[wiring.hot[cell]] = True
    while True:
        more = behind | (linked[behind].any(axis=0) & free)
        if (more == behind).all():
            return behind
        behind = more
