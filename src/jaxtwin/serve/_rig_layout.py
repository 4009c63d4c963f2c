"""What a page draws of a rig that does not change: plate or network, zones, cells, limits."""

from typing import Any

import numpy as np

from .._celsius import ZERO_CELSIUS
from ..physics import Twin, network_layout
from ..rig import Cell, Heater

# The digits of a place, m.
METRE_DIGITS = 5


def rig_layout(twin: Twin) -> dict[str, Any]:
    """Describes a twin's rig as a dictionary that JSON can hold.

    **Returns:** `rig`, `title`; `channels`, each with `name` and `zones` (left, right, top, bottom,
    m); `driven`, each with `name`, `lowest` duty and `outline` (corners x, y, m); `plate`, with
    `columns` and `rows`, the edges of its elements, m, or None; `network`, that of a rig without a
    plate of several elements, or None; `limit`, degC, or None; `nodes`, the names of the nodes that
    are not elements of the plate.
    """
    rig = twin.rig
    plate = rig.plate
    limit = rig.maximum_temperature
    lowest = dict(zip(rig.driven, rig.lowest_duty, strict=True))
    parts = {part.name: part for part in (*rig.cells, *rig.heaters)}
    elements = set(plate.element_names)
    return {
        "rig": rig.name,
        "title": rig.title,
        "channels": [
            {
                "name": channel.name,
                "zones": [_rounded(zone) for zone in channel.sensor.outline(plate)],
            }
            for channel in rig.channels
        ],
        "driven": [
            {"name": name, "lowest": lowest[name], "outline": _outline(twin, parts[name])}
            for name in rig.driven
        ],
        "plate": {"columns": _rounded(plate.column_edges), "rows": _rounded(plate.row_edges)}
        if len(elements) > 1  # a single one would be a square of one colour
        else None,
        "network": None if len(elements) > 1 else _network(twin),
        "limit": None if limit is None else round(limit - ZERO_CELSIUS, 2),
        "nodes": [node.name for node in twin.netlist.nodes if node.name not in elements],
    }


def _network(twin: Twin) -> dict[str, Any]:
    """The drawing of a network: `size`, its columns and rows; `nodes`, each with `name`, `column`,
    `row`, the `channels` that read it and the `driven` parts that heat it, whether it loses heat
    to the surroundings, and the temperature at which it is `held`, degC, or None; `links`, the
    pairs of their names; `elements`, the names of those that are elements of the plate."""
    rig, netlist = twin.rig, twin.netlist
    layout = network_layout(netlist)
    held = {
        reservoir.name: round(
            float(reservoir.temperature.evaluate(twin.numbers_si)) - ZERO_CELSIUS, 2
        )
        for reservoir in netlist.reservoirs
    }
    read: dict[str, list[str]] = {}
    for channel in rig.channels:
        weights = channel.sensor.weights(rig.plate)
        read.setdefault(max(weights, key=lambda name: weights[name]), []).append(channel.name)
    return {
        "size": layout.size,
        "nodes": [
            {
                "name": name,
                "column": column,
                "row": row,
                "channels": read.get(name, []),
                "driven": [cell.name for cell in netlist.cells if cell.cold == name],
                "is_losing": name in layout.lost,
                "held": held.get(name),
            }
            for name, (column, row) in layout.places.items()
        ],
        "links": list(layout.links),
        "elements": list(rig.plate.element_names),
    }


def _outline(twin: Twin, part: Cell | Heater) -> list[list[float]]:
    """The corners of the face of a cell or heater: where it is placed, or around the elements that
    it touches."""
    if part.placement is not None:
        return [_rounded(corner) for corner in part.placement.outline(twin.numbers_si)]
    plate = twin.rig.plate
    if isinstance(part, Cell):
        names = [name for name, _ in part.contacts]
    else:  # its heat goes into an element, or into a body of its own that touches some
        ends = [(link.a, link.b) for link in twin.netlist.links if part.name in (link.a, link.b)]
        names = [part.node, *(name for pair in ends for name in pair)]
    touched = np.array([plate.extent(name) for name in names if name in plate.element_names])
    if not len(touched):
        return []
    left, top = touched[:, 0].min(), touched[:, 2].min()
    right, bottom = touched[:, 1].max(), touched[:, 3].max()
    return [
        _rounded(corner) for corner in ((left, top), (right, top), (right, bottom), (left, bottom))
    ]


def _rounded(numbers: Any) -> list[float]:
    return np.round(np.asarray(numbers, float), METRE_DIGITS).tolist()
