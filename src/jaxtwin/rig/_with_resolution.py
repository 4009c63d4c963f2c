"""The same rig on another grid."""

from collections.abc import Iterator

from ._bundled import parse_toml
from ._problems import refuse
from ._rig import Rig


def with_resolution(rig: Rig, resolution: float) -> Rig:
    """Returns a rig whose plate has elements no larger than another resolution.

    **Arguments:**

    - `rig`: a rig that was read from a file.
    - `resolution`: m.

    **Raises:** `RigError` if the rig was not read from a file, its plate has no resolution, or a
    part of it names an element, which is another one on every grid.
    """
    from ._build import build_rig  # with pydantic, which only readers of a rig should pay for

    data = parse_toml(rig.text.encode(), rig.source)
    if "resolution" not in data.get("plate", {}):
        result = "columns and rows" if rig.has_plate else "no plate"
        if not rig.text:
            result = "a rig that was not read from a file"
        refuse(
            rig.source,
            "plate.resolution",
            "expected a plate with width, height and resolution, whose grid may be refined, got "
            f"{result}",
        )
    for field, element in _elements(rig):
        refuse(
            rig.source,
            field,
            "expected places in cm, so that the grid may be refined, got the element "
            f"{element}, which is another one on every grid",
        )
    data["plate"]["resolution"] = f"{resolution!r} m"
    return build_rig(data, rig.source)


def _elements(rig: Rig) -> Iterator[tuple[str, str]]:
    """The elements that the file names, each with the field that names it."""
    from ._nodes_sensor import NodesSensor

    named = [
        (f"cells[{cell.name}].contacts", node)
        for cell in rig.cells
        if cell.placement is None
        for node, _ in cell.contacts
    ]
    placed = {heater.name for heater in rig.heaters if heater.placement is not None}
    named += [(f"heaters[{heater.name}].contacts", heater.node) for heater in rig.heaters]
    named += [
        ("links", end)
        for link in rig.links
        for pair in link.between
        if not placed.intersection(pair)
        for end in pair
    ]
    named += [
        (f"channels[{channel.name}].nodes", node)
        for channel in rig.channels
        if isinstance(channel.sensor, NodesSensor)
        for node in channel.sensor.nodes
    ]
    named += [("initial.nodes", node) for node, _ in rig.initial_nodes]
    elements = set(rig.plate.element_names)
    return ((field, node) for field, node in named if node in elements)
