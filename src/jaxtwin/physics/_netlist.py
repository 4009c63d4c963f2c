"""The common form that every rig is turned into: nodes, links and thermoelectric cells."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, final

from ..rig import Input, Rig, Switched, Value
from ..rig._placement import is_derived
from ..rig._plate import AMBIENT
from ..rig._value import conductances, depends_on
from ._placed import all_values

LinkRole = Literal[
    "conduction", "film", "contact", "module", "sink", "body", "sensor", "convection", "radiation"
]
NodeKind = Literal["plate", "cell", "sink", "body", "sensor"]


@final
@dataclass(frozen=True)
class Node:
    """A lumped heat capacity at one temperature.

    **Arguments:**

    - `name`: unique in the netlist.
    - `kind`: the part of the rig to which it belongs: the plate, a side of a cell, a sink, a body,
      or a sensor with a lag.
    - `capacitance`: J/K.
    - `initial_temperature`: the temperature at the start of a run, K.
    """

    name: str
    kind: NodeKind
    capacitance: Value
    initial_temperature: Value


@final
@dataclass(frozen=True)
class Reservoir:
    """A body at a fixed temperature, whatever heat flows into it: coolant, an ice bath.

    **Arguments:**

    - `name`: unique in the netlist.
    - `temperature`: K.
    """

    name: str
    temperature: Value


@final
@dataclass(frozen=True)
class Link:
    """A thermal resistance between two nodes, or between a node and the surroundings or a
    reservoir.

    **Arguments:**

    - `a`, `b`: names of nodes; `b` may be `"ambient"` or a reservoir.
    - `resistances`: the resistances in series, K/W, such as conduction and convection of eq. (6).
    - `role`: the part that it represents: `"conduction"`, `"film"`, `"contact"`, `"module"`,
      `"sink"`, `"body"`, `"sensor"`, or `"convection"` and `"radiation"` for the linear part of
      these.
    - `conductances`: for a link that an input changes, or whose conductance depends on the place of
      a cell, the terms of the sum that is its conductance, which may be 0, W/K; such a link has no
      `resistances`.
    """

    a: str
    b: str
    resistances: tuple[Value, ...]
    role: LinkRole
    conductances: tuple[Value, ...] = ()

    @classmethod
    def of(
        cls, inputs: tuple[Input, ...], a: str, b: str, resistance: Value | Switched, role: Any
    ) -> "Link":
        """A link of one resistance, which may depend on the inputs of the rig or on the place of a
        cell."""
        if isinstance(resistance, Value) and not (
            depends_on(resistance, inputs) or is_derived(resistance)
        ):
            return cls(a, b, (resistance,), role)
        return cls(a, b, (), role, conductances(resistance))

    def resistance(self, values_si: Mapping[str, float]) -> float:
        """The whole resistance for given parameters and inputs in SI units, K/W."""
        if self.conductances:
            conductance = sum(value.evaluate(values_si) for value in self.conductances)
            return 1 / conductance if conductance else math.inf
        return sum(value.evaluate(values_si) for value in self.resistances)


# The voltage of the supply of a heater of a given power, V: its resistance is $V^2 / P$.
OWN_VOLTAGE = Value(1.0)


@final
@dataclass(frozen=True)
class ThermoelectricElement:
    """The heat that the current of one cell moves between its two sides.

    A heater is such an element too: one whose Seebeck coefficient is 0 and whose two sides are the
    same node, into which $q_h - q_c = R I^2$ flows.

    **Arguments:**

    - `name`: the name of the cell or heater.
    - `cold`, `hot`: nodes of the cold and the hot side, named as in eqs. (7)-(9). The cold side is
      the one at the plate; a drive that heats the plate reverses the current.
    - `seebeck_coefficient`: V/K.
    - `electrical_resistance`: ohm.
    - `thermal_resistance`: K/W; it is also one of the links. None for a heater.
    - `has_own_supply`: whether a supply of `OWN_VOLTAGE` without a resistance, which is switched on
      and off, feeds it in place of the driver's: a heater of a given power.
    - `drive_exponent`: that of a heater whose heat is no multiple of its duty, or None.
    """

    name: str
    cold: str
    hot: str
    seebeck_coefficient: Value
    electrical_resistance: Value
    thermal_resistance: Value | None = None
    has_own_supply: bool = False
    drive_exponent: Value | None = None

    @property
    def is_heater(self) -> bool:
        """Whether its two sides are the same node."""
        return self.cold == self.hot


@final
@dataclass(frozen=True)
class LossPath:
    """A link by natural convection and radiation; fields as in `NonlinearLink`.

    - `a`, `b`: a node, and a node, a reservoir or `"ambient"`.
    """

    a: str
    b: str
    convection: Value
    exponent: Value
    radiating: Value


@final
@dataclass(frozen=True)
class Loss:
    """What is not proportional to a temperature difference: the change of the plate's losses to
    the surroundings with its temperature, and links.

    - `exponent`: the conductance of links of the role `"film"` is proportional to the temperature
      difference to this power, and has the stated value at a difference of 20 K; None for a
      constant conductance.
    - `radiators`: pairs (node, emissivity times area, m^2, as the terms of a sum) for each
      radiating node.
    - `paths`: the links by natural convection and radiation.
    """

    exponent: Value | None = None
    radiators: tuple[tuple[str, tuple[Value, ...]], ...] = ()
    paths: tuple[LossPath, ...] = ()


@final
@dataclass(frozen=True, eq=False)
class Netlist:
    """A thermal network with thermoelectric cells and heaters.

    Netlists are equal, and have the same hash, when their contents are: compiled code is shared.

    **Arguments:**

    - `nodes`, `links`, `cells`: the parts of the network, in the order of all arrays. Heaters are
      the last of the `cells`.
    - `loss`: the nonlinear part of losses and links; None if they are linear.
    - `reservoirs`: the bodies at a fixed temperature, without the surroundings.
    """

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    cells: tuple[ThermoelectricElement, ...]
    loss: Loss | None = None
    reservoirs: tuple[Reservoir, ...] = ()

    @cached_property
    def index(self) -> dict[str, int]:
        """Position of each node."""
        return {node.name: position for position, node in enumerate(self.nodes)}

    def capacitance(self, values_si: Mapping[str, float], kind: NodeKind | None = None) -> float:
        """The heat capacity of all nodes, or of the nodes of a kind, J/K."""
        return sum(
            node.capacitance.evaluate(values_si) for node in self.nodes if kind in (None, node.kind)
        )

    def ambient_conductance(
        self, values_si: Mapping[str, float], kind: NodeKind | None = None
    ) -> float:
        """The conductance of all links to the surroundings, or of those of the nodes of a kind,
        W/K."""
        return sum(
            1 / link.resistance(values_si)
            for link in self.links
            if link.b == AMBIENT and kind in (None, self.nodes[self.index[link.a]].kind)
        )

    @cached_property
    def fingerprint(self) -> str:
        """A text that differs for netlists with different contents."""
        contents = repr((self.nodes, self.links, self.cells, self.loss, self.reservoirs))
        return hashlib.sha256(contents.encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Netlist) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __repr__(self) -> str:
        return (
            f"<Netlist: {len(self.nodes)} nodes, {len(self.links)} links, {len(self.cells)} cells>"
        )


def network_counts(netlist: Netlist, rig: Rig) -> dict[str, float | int]:
    """Counts and sums of a network, with the values of the rig's parameter table: those of the
    plate, or of all nodes if the rig has none."""
    values = all_values(rig, {n: row.to_si(row.value) for n, row in rig.parameters.items()})
    if not rig.has_plate:
        return {
            "states": len(netlist.nodes),
            "resistances": len(netlist.links),
            "capacitance_J_per_K": netlist.capacitance(values),
            "to_ambient_W_per_K": netlist.ambient_conductance(values),
        }
    return {
        "states": len(netlist.nodes),
        "plate_nodes": sum(node.kind == "plate" for node in netlist.nodes),
        "plate_resistances": sum(link.role in ("conduction", "film") for link in netlist.links),
        "plate_capacitance_J_per_K": netlist.capacitance(values, "plate"),
        "plate_to_ambient_W_per_K": netlist.ambient_conductance(values, "plate"),
    }


def network_text(counts: dict[str, float | int]) -> str:
    """A summary of a network, for all places that print one."""
    names = {
        "states": "state",
        "resistances": "resistance",
        "plate_nodes": "plate element",
        "plate_resistances": "resistance",
    }
    parts = [
        f"{counts[key]} {noun}{'s' * (counts[key] != 1)}"
        for key, noun in names.items()
        if key in counts
    ]
    return ", ".join(parts) + " on the plate" * ("plate_nodes" in counts)
