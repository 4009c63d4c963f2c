r"""Faults of a rig as changes of its equations: each model makes a function `System -> System`.

The virtual rig, the hypotheses of a diagnosis and tests use the same models. They are pure, and
differentiable in the size of the fault.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from .._jax_settings import settings_for
from .._name_suggestions import unknown_name
from ..errors import SimulationError
from ..rig import Registration, Rig, Value, ZoneSensor
from ._registration import RegisteredZones
from ._system import System
from ._twin import Twin

Fault: TypeAlias = Callable[[System], System]
"""The equations of a rig -> those of the same rig with a fault."""

FaultModel: TypeAlias = Callable[[Twin, str, Float[ArrayLike, ""]], Fault]
"""A twin, the part of its rig that is faulty, and the size of the fault -> the fault."""

# The resistance of a circuit that is interrupted, ohm.
OPEN_CIRCUIT_OHM = 1e9


def loosened_contact(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The contact resistances between a cell and what it touches are `factor` times as large; or
    all resistances between a heater with a heat capacity and other nodes.

    **Raises:** `SimulationError` if the rig has no such cell; so do the other models of cells.
    """
    rig = twin.rig
    apart = [heater.name for heater in rig.heaters if heater.node == heater.name]
    _checked_number("cell", cell, (*_cells(rig), *apart))
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


def open_circuit(twin: Twin, cell: str, share: Float[ArrayLike, ""] = 1.0) -> Fault:
    """A share of a cell's or heater's parallel strings is interrupted, 0 to 1; at 1 no current
    flows through it."""
    number = _checked_number("cell", cell, twin.rig.driven)

    def fault(system: System) -> System:
        before = jnp.asarray(system.module.electrical_resistance)
        closed = (1 - share) * OPEN_CIRCUIT_OHM / before[number]
        resistance = before.at[number].set(OPEN_CIRCUIT_OHM / (share + closed))
        return eqx.tree_at(lambda s: s.module.electrical_resistance, system, resistance)

    return fault


def aged_cell(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The electrical resistance of a cell or heater is `factor` times as large, as by cracks in its
    solder after many thermal cycles."""
    number = _checked_number("cell", cell, twin.rig.driven)

    def fault(system: System) -> System:
        resistance = jnp.asarray(system.module.electrical_resistance).at[number].multiply(factor)
        return eqx.tree_at(lambda s: s.module.electrical_resistance, system, resistance)

    return fault


def blocked_sink(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The resistances from the far side of a cell, and from what is mounted there, to the
    surroundings and to coolants are `factor` times as large. Cells that share a sink share the
    fault."""
    number = _checked_number("cell", cell, _cells(twin.rig))

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


def faded_cell(twin: Twin, cell: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The Seebeck coefficient of a cell is `factor` of what it was."""
    number = _checked_number("cell", cell, _cells(twin.rig))

    def fault(system: System) -> System:
        seebeck = jnp.asarray(system.module.seebeck_coefficient).at[number].multiply(factor)
        return eqx.tree_at(lambda s: s.module.seebeck_coefficient, system, seebeck)

    return fault


def reversed_cell(twin: Twin, cell: str, share: Float[ArrayLike, ""] = 1.0) -> Fault:
    """The polarity of a cell is swapped: at a `share` of 1 it cools where it should heat."""
    return faded_cell(twin, cell, 1 - 2 * jnp.asarray(share))


def weak_supply(twin: Twin, part: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The voltage of the supply, `part` "supply", is `factor` of what it was, for all cells and
    heaters, also for those of a given power; or that of a single cell or heater, by its name."""
    driven = twin.rig.driven
    number = _checked_number("part", part, ("supply", *driven)) - 1
    which = slice(None) if number < 0 else number

    def fault(system: System) -> System:
        before = system.bridge.supply_share
        whole = jnp.ones(len(driven), system.capacitance.dtype) if before is None else before
        share = whole.at[which].multiply(factor)
        return eqx.tree_at(
            lambda s: s.bridge.supply_share, system, share, is_leaf=lambda leaf: leaf is None
        )

    return fault


def leaking(twin: Twin, part: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The losses of a part to the surroundings are `factor` times as large, as by a draught or an
    open lid. `part` is a node, such as a body; "plate", with its radiation; or "all", everything
    that is not behind a cell.

    **Raises:** `SimulationError` if the rig has no such part.
    """
    nodes = _nodes_of(twin, part)

    def fault(system: System) -> System:
        chosen = np.isin(np.arange(len(system.capacitance)), nodes)
        if part == "all":
            for cell in range(len(system.wiring.cold)):
                if system.wiring.hot[cell] != system.wiring.cold[cell]:
                    chosen &= ~_behind(system, cell)
        more = jnp.where(chosen, system.ambient_conductance * (factor - 1), 0.0)
        changed = eqx.tree_at(
            lambda s: (s.ambient_conductance, s.conductance),
            system,
            (system.ambient_conductance + more, system.conductance + jnp.diag(more)),
        )
        if system.loss is None:
            return changed
        paths = system.wiring.loss_paths
        assert paths is not None
        of_path = jnp.where(chosen[paths.near] & (paths.far == -1), factor, 1.0)
        parts = [system.loss.film * of_path, system.loss.radiating * of_path]
        return eqx.tree_at(lambda s: [s.loss.film, s.loss.radiating], changed, parts)

    return fault


def loaded(twin: Twin, part: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The heat capacity of a part is `factor` times as large, as if something was put on it or
    in it. `part` is a node, such as a body; or "plate".

    **Raises:** `SimulationError` if the rig has no such part.
    """
    nodes = _nodes_of(twin, part)

    def fault(system: System) -> System:
        chosen = np.isin(np.arange(len(system.capacitance)), nodes)
        capacitance = system.capacitance * jnp.where(chosen, factor, 1.0)
        return eqx.tree_at(lambda s: s.capacitance, system, capacitance)

    return fault


def gained_channel(twin: Twin, channel: str, factor: Float[ArrayLike, ""]) -> Fault:
    """The gain of a channel is `factor` times as large, as by another emissivity of its zone.

    **Raises:** `SimulationError` if the rig has no such channel.
    """
    number = _checked_number("channel", channel, twin.channels)
    return lambda system: eqx.tree_at(
        lambda s: s.gain, system, jnp.asarray(system.gain).at[number].multiply(factor)
    )


def covered_channel(twin: Twin, channel: str, share: Float[ArrayLike, ""]) -> Fault:
    """A share of what a channel sees, 0 to 1, is covered by something as warm as the
    surroundings."""
    return gained_channel(twin, channel, 1 - share)


def offset_channel(twin: Twin, channel: str, offset: Float[ArrayLike, ""]) -> Fault:
    """A channel reads `offset` (K) too much."""
    number = _checked_number("channel", channel, twin.channels)

    def fault(system: System) -> System:
        added = jnp.zeros_like(system.gain) if system.offset is None else system.offset
        return eqx.tree_at(
            lambda s: s.offset,
            system,
            added.at[number].add(offset),
            is_leaf=lambda leaf: leaf is None,
        )

    return fault


def swapped_channels(twin: Twin, pair: str, share: Float[ArrayLike, ""] = 1.0) -> Fault:
    """Two channels, "T11+T12", are swapped: at a `share` of 1 each reads what the other should."""
    first, _, second = pair.partition("+")
    numbers = np.array(
        [_checked_number("channel", name, twin.channels) for name in (first, second)]
    )

    def fault(system: System) -> System:
        weights, gain = jnp.asarray(system.channel_weights), jnp.asarray(system.gain)
        weights, gain = (
            table.at[numbers].set((1 - share) * table[numbers] + share * table[numbers[::-1]])
            for table in (weights, gain)
        )
        return eqx.tree_at(
            lambda s: (s.moved_weights, s.gain),
            system,
            (weights.astype(gain.dtype), gain),
            is_leaf=lambda leaf: leaf is None,
        )

    return fault


def delayed_command(twin: Twin, part: str, seconds: Float[ArrayLike, ""]) -> Fault:
    """Commands, `part` "command", take effect `seconds` later than they should.

    **Raises:** `SimulationError` for a rig whose driver has no delay.
    """
    _checked_number("part", part, ("command",))
    if twin.rig.driver.delay is None:
        raise SimulationError(f"{twin.rig.name}: fault: expected a driver with a delay")

    def fault(system: System) -> System:
        assert system.delay is not None
        return eqx.tree_at(lambda s: s.delay, system, system.delay + seconds)

    return fault


def moved_camera(twin: Twin, axis: str, shift: Float[ArrayLike, ""]) -> Fault:
    """The zones of the camera's picture lie `shift` (m) farther along the plate's `axis`, "x" or
    "y".

    **Raises:** `SimulationError` for another axis, or for a rig whose channels are not all zones of
    a picture.
    """
    across = _checked_number("axis", axis, ("x", "y"))
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


def changed_parameter(twin: Twin, name: str, factor: Float[ArrayLike, ""]) -> Fault:
    """A parameter of the rig file is `factor` times as large.

    **Raises:** `SimulationError` if the rig has no such parameter.
    """
    _checked_number("parameter", name, tuple(twin.rig.parameters))

    def fault(system: System) -> System:
        value = jnp.asarray(twin.values[name]) * factor
        before, after = twin.system(), twin.with_values({name: value}).system()
        change = {
            keys: new - old
            for (keys, new), (_, old) in zip(
                *(jax.tree_util.tree_leaves_with_path(system) for system in (after, before)),
                strict=True,
            )
            if eqx.is_inexact_array(new)
        }
        return jax.tree_util.tree_map_with_path(
            lambda keys, leaf: leaf + change[keys] if keys in change else leaf, system
        )

    return fault


def in_own_precision(model: FaultModel) -> FaultModel:
    """The same model, computed in float64 whatever JAX is set to, or in the precision of the user
    where it is traced."""

    def made(twin: Twin, part: str, size: Float[ArrayLike, ""]) -> Fault:
        with settings_for(twin, size):
            fault = model(twin, part, size)

        def precise(system: System) -> System:
            with settings_for(twin, size, system):
                return fault(system)

        return precise

    return made


FAULT_MODELS: Mapping[str, FaultModel] = {
    name: in_own_precision(model)
    for name, model in {
        "loosen": loosened_contact,
        "fail": open_circuit,
        "age": aged_cell,
        "fade": faded_cell,
        "reverse": reversed_cell,
        "block": blocked_sink,
        "weaken": weak_supply,
        "leak": leaking,
        "load": loaded,
        "gain": gained_channel,
        "cover": covered_channel,
        "offset": offset_channel,
        "swap": swapped_channels,
        "move": moved_camera,
        "delay": delayed_command,
        "change": changed_parameter,
    }.items()
}
"""The models by the words of `jaxtwin virtual-rig --faults`; a new model is entered here."""

# The models whose size may be negative; the others are factors, shares and times.
SIGNED_MODELS = ("move", "offset")


def _cells(rig: Rig) -> tuple[str, ...]:
    return tuple(cell.name for cell in rig.cells)


def _nodes_of(twin: Twin, part: str) -> Int[np.ndarray, " nodes"]:
    """The numbers of the nodes of a part: of one by its name, of the plate, or all."""
    index, elements = twin.netlist.index, twin.wiring.elements
    parts = ("all", *(("plate",) if elements else ()), *index)
    _checked_number("part", part, parts)
    if part == "plate":
        return np.arange(elements)
    return np.arange(len(index)) if part == "all" else np.array([index[part]])


def _checked_number(kind: str, name: str, names: tuple[str, ...]) -> int:
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
