"""Combines nodes that always have the same temperature into a single node.

A symmetric plate has mirror images of nodes: they have the same capacitance and the same links to
the same neighbours. Their temperatures stay equal for all parameter values and inputs. A single
node with the sum of their capacitances, and with their links in parallel, therefore represents all
of them exactly.
"""

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from ..rig import Value
from ..rig._plate import AMBIENT
from ._netlist import Link, Loss, Netlist


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
