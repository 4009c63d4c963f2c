"""Builds the netlist of a rig, with one node for nodes that always have the same temperature."""

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from .._arguments import of_kind
from .._name_suggestions import unknown_name
from ..errors import RigError
from ..rig import Heater, NonlinearLink, Rig, Value
from ..rig._plate import AMBIENT
from ._heat_loss import RADIATION_AT_REFERENCE, STEFAN_BOLTZMANN
from ._netlist import (
    OWN_VOLTAGE,
    Link,
    LinkRole,
    Loss,
    LossPath,
    Netlist,
    Node,
    Reservoir,
    ThermoelectricElement,
)
from ._placed import bare_faces
from ._plate import FULL_FACE, circuit_links, element_capacitance, exposed_area, finite_volume_links
from ._sensors import lagging_sensors


def build_netlist(rig: Rig) -> Netlist:
    """Builds the network of a whole rig: plate elements first, then the nodes of each cell.

    A cell adds a plate side `<cell>.TC`, a far side `<cell>.TH` and, if the rig gives one, a
    sink `<cell>.SINK`, with the links plate - TC - TH - (SINK -) ambient of Fig. 9b and 13a. The
    bodies that have a heat capacity follow. A body at a fixed temperature becomes a reservoir. A
    heater is an element of the network without nodes of its own. A channel whose sensor has a lag
    adds the sensor, `<channel>.SENSOR`.
    """
    of_kind("build_netlist: rig", rig, Rig, "a Rig, as load_rig reads it", RigError)
    plate = rig.plate
    capacitances, links = {}, []
    if rig.circuit is not None:
        capacitances = dict.fromkeys(plate.element_names, rig.circuit.capacitance)
        links = circuit_links(rig.circuit, rig.inputs)
    elif rig.has_plate:
        capacitances = {name: element_capacitance(plate, name) for name in plate.element_names}
        links = finite_volume_links(plate, bare_faces(rig))
    start = rig.initial_temperature
    at_start = {
        body.name: body.temperature or body.initial_temperature or start for body in rig.bodies
    }
    nodes = [Node(name, "plate", capacitance, start) for name, capacitance in capacitances.items()]
    cells = []
    for cell in rig.cells:
        cold, hot = f"{cell.name}.TC", f"{cell.name}.TH"
        behind = cell.sink_initial_temperature or start
        if cell.sink is not None:
            behind = at_start[cell.sink]
        touched, _ = cell.contacts[0]
        for side, beside in ((cold, at_start.get(touched, start)), (hot, behind)):
            initial = cell.initial_temperature or beside
            nodes.append(Node(side, "cell", cell.side_capacitance, initial))
        links += [
            Link.of(rig.inputs, node, cold, value, "contact") for node, value in cell.contacts
        ]
        links.append(Link(cold, hot, (cell.thermal_resistance,), "module"))
        sink = cell.sink or AMBIENT
        if cell.sink_capacitance is not None:
            sink = f"{cell.name}.SINK"
            nodes.append(Node(sink, "sink", cell.sink_capacitance, behind))
        if cell.sink_resistance is not None:
            links.append(Link.of(rig.inputs, hot, sink, cell.sink_resistance, "sink"))
        if cell.sink_air_resistance is not None:
            links.append(Link.of(rig.inputs, sink, AMBIENT, cell.sink_air_resistance, "sink"))
        cells.append(
            ThermoelectricElement(
                name=cell.name,
                cold=cold,
                hot=hot,
                seebeck_coefficient=cell.seebeck_coefficient,
                electrical_resistance=cell.electrical_resistance,
                thermal_resistance=cell.thermal_resistance,
            )
        )
    cells += [_heater_element(heater) for heater in rig.heaters]
    nodes += [
        Node(body.name, "body", body.capacitance, at_start[body.name])
        for body in rig.bodies
        if body.capacitance is not None
    ]
    reservoirs = tuple(
        Reservoir(body.name, body.temperature)
        for body in rig.bodies
        if body.temperature is not None
    )
    held = {AMBIENT, *(reservoir.name for reservoir in reservoirs)}
    paths: list[LossPath] = []
    for link in rig.links:
        for pair in link.between:
            a, b = pair[::-1] if pair[0] in held else pair
            if isinstance(link, NonlinearLink):
                paths.append(_loss_path(link, a, b))
                links += _linear_parts(paths[-1])
            else:
                links.append(Link.of(rig.inputs, a, b, link.resistance * link.factor, "body"))
    sensors, sensor_links = lagging_sensors(rig, nodes)
    nodes = _with_own_starts(rig, (*nodes, *sensors))
    return Netlist(nodes, (*links, *sensor_links), tuple(cells), _loss(rig, paths), reservoirs)


def _loss_path(link: NonlinearLink, a: str, b: str) -> LossPath:
    none = Value(0.0)
    return LossPath(a, b, link.convection or none, link.exponent, link.radiating_area or none)


def _linear_parts(path: LossPath) -> list[Link]:
    """What the network contains of a path, so that all that is stiff is in it."""
    by_area = Value(STEFAN_BOLTZMANN * RADIATION_AT_REFERENCE)
    parts: list[tuple[LinkRole, Value]] = [
        ("convection", path.convection),
        ("radiation", by_area * path.radiating),
    ]
    return [Link(path.a, path.b, (), role, (value,)) for role, value in parts if value.factor]


def _with_own_starts(rig: Rig, nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """The nodes, of which some have a temperature of their own at the start.

    **Raises:** `RigError` for a node that the rig does not have.
    """
    own = dict(rig.initial_nodes)
    known = [node.name for node in nodes]
    for name in own:
        if name not in known:
            raise RigError(f"{rig.source}: initial.nodes: {unknown_name('node', name, known)}")
    return tuple(
        replace(node, initial_temperature=own.get(node.name, node.initial_temperature))
        for node in nodes
    )


def _heater_element(heater: Heater) -> ThermoelectricElement:
    resistance = heater.electrical_resistance
    if heater.power is not None:
        resistance = OWN_VOLTAGE * OWN_VOLTAGE / heater.power
    assert resistance is not None
    return ThermoelectricElement(
        name=heater.name,
        cold=heater.node,
        hot=heater.node,
        seebeck_coefficient=Value(0.0),
        electrical_resistance=resistance,
        has_own_supply=heater.power is not None,
        drive_exponent=heater.drive_exponent,
    )


def _loss(rig: Rig, paths: Sequence[LossPath]) -> Loss | None:
    """The nonlinear part of the plate's losses and of the links."""
    plate = rig.plate
    radiators = []
    if plate.emissivity is not None:
        bare = bare_faces(rig)
        for name in plate.element_names:
            area = exposed_area(plate, name, bare.get(name, FULL_FACE))
            radiators.append((name, tuple(plate.emissivity * term for term in area)))
    if plate.film_exponent is None and not radiators and not paths:
        return None
    return Loss(plate.film_exponent, tuple(radiators), tuple(paths))


# Combines nodes that always have the same temperature into a single node.
#
# A symmetric plate has mirror images of nodes: they have the same capacitance and the same links to
# the same neighbours. Their temperatures stay equal for all parameter values and inputs. A single
# node with the sum of their capacitances, and with their links in parallel, therefore represents
# all of them exactly.


def lump(netlist: Netlist) -> tuple[Netlist, Int[np.ndarray, " nodes"]]:
    """Combines equal nodes of a netlist.

    **Returns:** the smaller netlist, whose nodes have the names of their first members, and the
    position in it of each node of the given netlist.
    """
    classes = _equal_nodes(netlist)
    first = {number: node for node, number in reversed(list(enumerate(classes)))}
    sizes = Counter(classes)
    nodes = tuple(
        replace(netlist.nodes[first[c]], capacitance=netlist.nodes[first[c]].capacitance * sizes[c])
        for c in range(len(sizes))
    )
    name = {node.name: nodes[c].name for node, c in zip(netlist.nodes, classes, strict=True)}
    held = {AMBIENT, *(reservoir.name for reservoir in netlist.reservoirs)}
    name |= {end: end for end in held}
    parallel: Counter[Link] = Counter()
    for link in netlist.links:
        a, b = name[link.a], name[link.b]
        if b not in held and a > b:
            a, b = b, a
        # No heat flows between equal nodes.
        if a != b:
            parallel[replace(link, a=a, b=b)] += 1
    links = tuple(
        replace(
            link,
            resistances=tuple(value / count for value in link.resistances),
            conductances=tuple(value * count for value in link.conductances),
        )
        for link, count in parallel.items()
    )
    loss = _lumped_loss(netlist, name)
    lumped = Netlist(nodes, links, netlist.cells, loss, netlist.reservoirs)
    return lumped, np.array(classes, dtype=np.int32)


def _lumped_loss(netlist: Netlist, name: dict[str, str]) -> Loss | None:
    """The losses of the smaller netlist: the radiating areas of equal nodes are added."""
    if netlist.loss is None:
        return None
    radiators: dict[str, tuple[Value, ...]] = {}
    for node, areas in netlist.loss.radiators:
        radiators[name[node]] = radiators.get(name[node], ()) + areas
    paths = tuple(replace(path, a=name[path.a], b=name[path.b]) for path in netlist.loss.paths)
    return Loss(netlist.loss.exponent, tuple(radiators.items()), paths)


def _equal_nodes(netlist: Netlist) -> list[int]:
    """The coarsest division into classes in which equal nodes have equal neighbours.

    This is colour refinement: the first classes are nodes of the same kind and capacitance. Nodes
    whose links lead to different classes are then separated until nothing changes. Expressions are
    compared, not numbers, so that the division holds for all values of the parameters.
    """
    index = netlist.index
    held = {AMBIENT: len(index)}
    held |= {r.name: len(index) + 1 + number for number, r in enumerate(netlist.reservoirs)}
    resistances = _numbered([(link.resistances, link.conductances) for link in netlist.links])
    ends = np.array([(index[x.a], (index if x.b in index else held)[x.b]) for x in netlist.links]).T
    inner = ends[1] < len(index)
    # Each link is listed for both of its ends, except ends at a fixed temperature.
    of_link = np.concatenate([resistances, np.array(resistances, dtype=int)[inner]])
    node = np.concatenate([ends[0], ends[1][inner]])
    other = np.concatenate([ends[1], ends[0][inner]])
    starts = np.searchsorted(np.sort(node), np.arange(len(netlist.nodes) + 1))
    radiating = dict(netlist.loss.radiators) if netlist.loss is not None else {}
    # The sides of the cells are not combined, because each cell has its drive, nor are the ends of
    # nonlinear links, whose laws are no part of the links.
    sides = {side for cell in netlist.cells for side in (cell.cold, cell.hot)}
    if netlist.loss is not None:
        sides |= {end for path in netlist.loss.paths for end in (path.a, path.b)}
    colours = _numbered(
        [
            (
                node.kind,
                node.capacitance,
                node.initial_temperature,
                radiating.get(node.name),
                node.name if node.name in sides else "",
            )
            for node in netlist.nodes
        ]
    )
    while True:
        # A number for each pair of a resistance and the class of the node behind it.
        behind = np.append(colours, list(held.values()))[other]
        pairs = of_link * (len(colours) + len(held)) + behind
        seen = pairs[np.lexsort((pairs, node))]
        refined = _numbered(
            [
                (colour, seen[start:stop].tobytes())
                for colour, start, stop in zip(colours, starts[:-1], starts[1:], strict=True)
            ]
        )
        if max(refined) == max(colours):
            return colours
        colours = refined


def _numbered(keys: Sequence[Hashable]) -> list[int]:
    """Each key's number, in the order of first appearance."""
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    return [numbers[key] for key in keys]
