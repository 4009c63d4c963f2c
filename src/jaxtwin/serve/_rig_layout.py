"""What a page draws of a rig that does not change: plate, zones, cells, names and limits."""

from typing import Any

import numpy as np

from .._celsius import ZERO_CELSIUS
from ..physics import Twin
from ..rig._cell import Cell
from ..rig._heater import Heater

# The digits of a place, m.
METRE_DIGITS = 5


def rig_layout(twin: Twin) -> dict[str, Any]:
    """Describes a twin's rig as a dictionary that JSON can hold.

    **Returns:** `rig`, `title`; `channels`, each with `name` and `zones` (left, right, top, bottom,
    m); `driven`, each with `name`, `lowest` duty and `outline` (corners x, y, m); `plate`, with
    `columns` and `rows`, the edges of its elements, m, or None; `limit`, degC, or None; `nodes`,
    the names of the nodes that are not elements of the plate.
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
        if rig.has_plate
        else None,
        "limit": None if limit is None else round(limit - ZERO_CELSIUS, 2),
        "nodes": [node.name for node in twin.netlist.nodes if node.name not in elements],
    }


def _outline(twin: Twin, part: Cell | Heater) -> list[list[float]]:
    """The corners of the face of a cell or heater: where it is placed, or around the elements that
    it touches."""
    if part.placement is not None:
        return [_rounded(corner) for corner in part.placement.outline(twin.numbers_si)]
    plate = twin.rig.plate
    contacts = part.contacts if isinstance(part, Cell) else ()
    touched = np.array([plate.extent(name) for name, _ in contacts if name in plate.element_names])
    if not len(touched):
        return []
    left, top = touched[:, 0].min(), touched[:, 2].min()
    right, bottom = touched[:, 1].max(), touched[:, 3].max()
    return [
        _rounded(corner) for corner in ((left, top), (right, top), (right, bottom), (left, bottom))
    ]


def _rounded(numbers: Any) -> list[float]:
    return np.round(np.asarray(numbers, float), METRE_DIGITS).tolist()
