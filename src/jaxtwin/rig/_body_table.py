"""Builds bodies and links from the tables `[[bodies]]` and `[[links]]` of a rig file."""

from collections.abc import Sequence
from functools import partial

from ._body import Body
from ._circuit import CircuitLink
from ._circuit_table import link_ends
from ._fan_table import blown
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._schema import BodyLinkTable, BodyTable
from ._units import HEAT_CAPACITY, TEMPERATURE


def build_bodies(tables: Sequence[BodyTable], plate: Plate, fields: Fields) -> tuple[Body, ...]:
    """The bodies of a file.

    **Raises:** `RigError` if a value or a name is wrong, or a body has neither a heat capacity
    nor a fixed temperature, or both.
    """
    fields.check_unique("bodies", [table.name for table in tables])
    return tuple(body_of(table, f"bodies[{table.name}]", plate, fields) for table in tables)


def body_of(table: BodyTable, at: str, plate: Plate, fields: Fields) -> Body:
    """A body.

    **Arguments:**

    - `at`: the place of its table in the file, for messages.

    **Raises:** `RigError` as `build_bodies`.
    """
    if not table.name.isidentifier() or table.name in (AMBIENT, *plate.element_names):
        fields.refuse(
            f"{at}.name",
            "expected letters, digits and _, and neither an element of the plate nor "
            f"{AMBIENT!r}, got {table.name!r}",
        )
    if (table.capacitance is None) == (table.temperature is None):
        result = "neither" if table.capacitance is None else "both"
        fields.refuse(at, f"expected either a capacitance or a temperature, got {result}")
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
        resistance = fields.varying_path(f"{at}.resistance", table.resistance)
        pairs = []
        for text in table.between:
            ends = link_ends(f"{at}.between", text, plate.element_names, fields, others)
            if held.issuperset(ends):
                fields.refuse(
                    f"{at}.between",
                    f"expected an end whose temperature is not held, got {text!r}; remove the link",
                )
            pairs.append(ends)
        if resistance is not None:
            resistance = blown(resistance, table.fan, at, fields)
            links.append(CircuitLink(resistance, table.factor, tuple(pairs)))
    return tuple(links)
