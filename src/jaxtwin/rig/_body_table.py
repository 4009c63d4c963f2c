"""Builds bodies and links from the tables `[[bodies]]` and `[[links]]` of a rig file."""

from collections.abc import Iterable, Sequence
from functools import partial

from ._body import Body
from ._circuit import CircuitLink
from ._circuit_table import link_ends
from ._fan_table import blown
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._schema import BodyLinkTable, BodyTable, CellTable
from ._units import HEAT_CAPACITY, TEMPERATURE, THERMAL_RESISTANCE


def build_bodies(tables: Sequence[BodyTable], plate: Plate, fields: Fields) -> tuple[Body, ...]:
    """The bodies of a file.

    **Raises:** `RigError` if a value or a name is wrong, or a body has neither a heat capacity
    nor a fixed temperature, or both.
    """
    fields.check_unique("bodies", [table.name for table in tables])
    return tuple(_build_body(table, plate, fields) for table in tables)


def _build_body(table: BodyTable, plate: Plate, fields: Fields) -> Body:
    at = f"bodies[{table.name}]"
    if not table.name.isidentifier() or table.name in (AMBIENT, *plate.element_names):
        fields.refuse(
            f"{at}.name",
            "expected letters, digits and _, and neither an element of the plate nor "
            f"{AMBIENT!r}, got {table.name!r}",
        )
    if (table.capacitance is None) == (table.temperature is None):
        found = "neither" if table.capacitance is None else "both"
        fields.refuse(at, f"expected either a capacitance or a temperature, got {found}")
    if table.temperature is not None and table.initial_temperature is not None:
        fields.refuse(
            f"{at}.initial_temperature", "expected none beside a temperature; remove one of them"
        )
    convert = {
        "capacitance": partial(fields.value, kind=HEAT_CAPACITY),
        "temperature": partial(fields.input_or_value, kind=TEMPERATURE),
        "initial_temperature": partial(fields.value, kind=TEMPERATURE),
    }
    values = {
        name: None if text is None else converted(f"{at}.{name}", text)
        for name, converted in convert.items()
        for text in (getattr(table, name),)
    }
    return Body(table.name, **values)


def build_links(
    tables: Sequence[BodyLinkTable], plate: Plate, bodies: Sequence[Body], fields: Fields
) -> tuple[CircuitLink, ...]:
    """The links between bodies, elements of the plate and the surroundings.

    **Raises:** `RigError` if a value is wrong, an end is unknown, or both ends have a fixed
    temperature.
    """
    held = {AMBIENT, *(body.name for body in bodies if body.temperature is not None)}
    others = (AMBIENT, *(body.name for body in bodies))
    links = []
    for table in tables:
        at = f"links[{table.resistance}]"
        resistance = fields.varying(f"{at}.resistance", table.resistance, THERMAL_RESISTANCE)
        resistance = blown(resistance, table.fan, at, fields)
        pairs = []
        for text in table.between:
            ends = link_ends(f"{at}.between", text, plate.element_names, fields, others)
            if held.issuperset(ends):
                fields.refuse(
                    f"{at}.between",
                    f"expected an end whose temperature is not held, got {text!r}; remove the link",
                )
            pairs.append(ends)
        links.append(CircuitLink(resistance, table.factor, tuple(pairs)))
    return tuple(links)


def check_bodies_grounded(
    bodies: Sequence[Body],
    links: Iterable[CircuitLink],
    cells: Sequence[CellTable],
    fields: Fields,
) -> None:
    """Refuses a body without a path for its heat to the plate or to a fixed temperature."""
    waiting = {body.name for body in bodies if body.temperature is None}
    pairs = [pair for link in links for pair in link.between]
    pairs += [(element, cell.sink) for cell in cells if cell.sink for element in cell.contacts]
    changed = True
    while changed:
        reached = {
            end
            for pair in pairs
            for end, other in (pair, pair[::-1])
            if end in waiting and other not in waiting
        }
        waiting -= reached
        changed = bool(reached)
    for body in bodies:
        if body.name in waiting:
            fields.refuse(
                f"bodies[{body.name}]",
                "expected a path for its heat to the plate, to ambient or to a body that is held "
                "at a temperature, got none; add a link",
            )
