"""The places of the nodes of a network without a plate in a drawing: in columns, by the number of
links from what is driven."""

from collections.abc import Sequence
from typing import NamedTuple, final

from ..rig._plate import AMBIENT
from ._netlist import Link, Netlist


@final
class NetworkLayout(NamedTuple):
    """A drawing whose links lead from a column to the next, or within one.

    - `places`: node or reservoir -> column and row, from 0; a column with fewer nodes than others
      stands in their middle.
    - `links`: the links between two of them, for each pair those that are parallel.
    - `lost`: the links from a node to the surroundings.
    """

    places: dict[str, tuple[float, float]]
    links: dict[tuple[str, str], list[Link]]
    lost: dict[str, list[Link]]

    @property
    def size(self) -> tuple[int, int]:
        """The number of columns and of rows."""
        columns, rows = zip(*self.places.values(), strict=True)
        return int(max(columns)) + 1, int(max(rows) + min(rows)) + 1


def network_layout(netlist: Netlist, elements: Sequence[str] = ()) -> NetworkLayout:
    """Places all nodes but those of sensors and the `elements` of a plate."""
    hidden = {*elements, *(node.name for node in netlist.nodes if node.kind == "sensor")}
    names = [
        place.name for place in (*netlist.nodes, *netlist.reservoirs) if place.name not in hidden
    ]
    links: dict[tuple[str, str], list[Link]] = {}
    lost: dict[str, list[Link]] = {}
    for link in netlist.links:
        if link.a in names and link.b == AMBIENT:
            lost.setdefault(link.a, []).append(link)
        elif link.a in names and link.b in names:
            a, b = sorted((link.a, link.b), key=names.index)
            links.setdefault((a, b), []).append(link)
    beside = {name: [b if a == name else a for a, b in links if name in (a, b)] for name in names}
    driven = [cell.cold for cell in netlist.cells if cell.cold in beside]
    columns = [list(dict.fromkeys(driven)) or names[:1]]
    left = [name for name in names if name not in columns[0]]
    while left:
        following = [name for name in left if set(beside[name]) & set(columns[-1])]
        # What no link reaches stands at the end.
        columns.append(following or left)
        left = [name for name in left if name not in columns[-1]]
    rows = max(len(column) for column in columns)
    places: dict[str, tuple[float, float]] = {}
    for number, column in enumerate(columns):
        near = {
            name: [places[other][1] for other in beside[name] if other in places] for name in column
        }
        column.sort(key=lambda name: sum(near[name]) / max(len(near[name]), 1))
        for row, name in enumerate(column):
            places[name] = float(number), row + (rows - len(column)) / 2
    if len(columns) == 1:  # side by side, as people read
        places = {name: (row, column) for name, (column, row) in places.items()}
    return NetworkLayout(places, links, lost)
