"""The same rig with cells and heaters at other places, with further cells, or on another grid."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from ._rig import Rig
from ._toml import parse_toml, refuse

_HEADER = re.compile(r"^[ \t]*\[{1,2}[ \t]*([A-Za-z0-9_.-]+)[ \t]*\]{1,2}[ \t]*(#.*)?$", re.M)
_NAME = re.compile(r"""^([ \t]*name[ \t]*=[ \t]*)(["'])(.*?)\2""", re.M)
_AT = re.compile(r"^([ \t]*at[ \t]*=[ \t]*)\[[^\]]*\]", re.M)

# x and y of the middle of a face, m.
Place = tuple[float, float]


class _Table(NamedTuple):
    """The text of a cell or heater in a rig file."""

    name: str
    start: int
    end: int


def with_places(rig: Rig, places: Mapping[str, Place], copies: Mapping[str, str]) -> Rig:
    """Returns a rig whose file has other places for cells and heaters that lie on its plate.

    The text of the file stays as it is elsewhere, with its comments.

    **Arguments:**

    - `rig`: a rig that was read from a file.
    - `places`: name of a cell or heater -> x and y of its middle, m. Parameters that
      were these places are left out.
    - `copies`: name of a further cell -> the cell whose table it is a copy of; its place is one of
      `places`.

    **Raises:** `RigError` if the rig was not read from a file, or its file does not have a table
    `[[cells]]` or `[[heaters]]` with a name and a place for each.
    """
    from ._build import parse_rig  # with pydantic, which only readers of a rig should pay for

    if not rig.text:
        refuse(rig.source, "", "expected a rig that was read from a file, got one that was not")
    text = rig.text
    for name, original in copies.items():
        tables = _tables(text)
        table = _table(rig, tables, original)
        end = max(table.end for table in tables)
        renamed = rf"\g<1>\g<2>{name}\g<2>"
        copy = _NAME.sub(renamed, text[table.start : table.end], count=1)
        text = f"{text[:end].rstrip()}\n\n{copy.rstrip()}\n{text[end:]}"
    for name, (x, y) in places.items():
        table = _table(rig, _tables(text), name)
        place = f'["{100 * x:.9g} cm", "{100 * y:.9g} cm"]'
        content, count = _AT.subn(lambda m, at=place: m[1] + at, text[table.start : table.end])
        if count != 1:
            refuse(rig.source, name, "expected a place, such as at = [...], in its table, got none")
        text = text[: table.start] + content + text[table.end :]
    for name in _parameters_of_places(rig, places):
        text = _without_parameter(text, name)
    return parse_rig(text.encode(), rig.source)


def _parameters_of_places(rig: Rig, places: Mapping[str, Place]) -> set[str]:
    """The parameters of the places that are replaced."""
    replaced = [placement for placement in rig.placements if placement.name in places]
    return {
        name for placement in replaced for at in (placement.x, placement.y) for name, _ in at.powers
    }


def _without_parameter(text: str, name: str) -> str:
    """The text without the row of a parameter, unless something else still names it."""
    if re.search(rf"""["']{re.escape(name)}["']""", text):
        return text
    row = rf"^[ \t]*(parameters[ \t]*\.[ \t]*)?{re.escape(name)}[ \t]*=.*\n?"
    table = rf"^[ \t]*\[parameters\.{re.escape(name)}\].*\n(?:(?![ \t]*\[).*\n?)*"
    return re.sub(f"{table}|{row}", "", text, flags=re.MULTILINE)


def _tables(text: str) -> Sequence[_Table]:
    """The tables of cells and heaters. A table ends where the comments above the next one begin."""
    headers = [*_HEADER.finditer(text)]
    starts = [header.start() for header in headers]
    result: list[_Table] = []
    for header, end in zip(headers, [*starts, len(text)][1:], strict=True):
        kind = header[1].split(".")
        if kind[0] not in ("cells", "heaters"):
            continue
        own = re.sub(r"(^[ \t]*#.*\n|^[ \t]*\n)+\Z", "", text[header.start() : end], flags=re.M)
        if len(kind) > 1 and result:  # a table of a cell, such as [cells.fan]
            result[-1] = result[-1]._replace(end=header.start() + len(own))
        elif (name := _NAME.search(own)) is not None:
            result.append(_Table(name[3], header.start(), header.start() + len(own)))
    return result


def _table(rig: Rig, tables: Sequence[_Table], name: str) -> _Table:
    result = next((table for table in tables if table.name == name), None)
    if result is None:
        refuse(rig.source, name, "expected a table [[cells]] or [[heaters]] of this name, got none")
    return result


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
    from ._sensors import NodesSensor

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
