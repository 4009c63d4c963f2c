"""Builds bodies and links from the tables `[[bodies]]` and `[[links]]` of a rig file."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from ._body import Body
from ._circuit import CircuitLink, NonlinearLink
from ._circuit_table import link_ends
from ._fan_table import blown
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._schema import BodyLinkTable, BodyTable
from ._units import (
    AREA,
    CONDUCTANCE,
    EMISSIVITY,
    EXPONENT,
    HEAT_CAPACITY,
    TEMPERATURE,
    THERMAL_RESISTANCE,
    Kind,
)
from ._value import Value

# The exponent of natural convection in laminar flow.
LAMINAR = Value(0.25)


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
) -> tuple[CircuitLink | NonlinearLink, ...]:
    """The links between bodies, elements of the plate and the surroundings.

    **Raises:** `RigError` if a value is wrong, an end is unknown, both ends have a fixed
    temperature, or a link carries no heat.
    """
    held = {AMBIENT, *(body.name for body in bodies if body.temperature is not None)}
    others = (AMBIENT, *(body.name for body in bodies))
    links: list[CircuitLink | NonlinearLink] = []
    for table in tables:
        at = f"links[{table.resistance or table.between[0]}]"
        resistance = None
        if table.resistance is not None:
            resistance = fields.varying_path(f"{at}.resistance", table.resistance)
        nonlinear = _nonlinear(table, at, fields)
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
        if nonlinear is not None:
            _check_ends(pairs, bodies, at, fields)
            links.append(replace(nonlinear, between=tuple(pairs)))
    return tuple(links)


def _nonlinear(table: BodyLinkTable, at: str, fields: Fields) -> NonlinearLink | None:
    """The natural convection and radiation of a link, without its ends; None for neither.

    **Raises:** `RigError` if a value is wrong, or a key has another beside it that it needs.
    """
    needed = {
        "convection_exponent": "convection",
        "emissivity": "radiating_area",
        "fan": "resistance",
    }
    for key, beside in needed.items():
        if getattr(table, key) is not None and getattr(table, beside) is None:
            fields.refuse(f"{at}.{key}", f"expected {beside} beside it, got none; give it")
    if table.factor != 1 and table.resistance is None:
        fields.refuse(f"{at}.factor", "expected a resistance beside it, got none; remove it")
    if table.convection is None and table.radiating_area is None:
        if table.resistance is None:
            expected = f"a resistance, {THERMAL_RESISTANCE}, or convection or a radiating_area"
            fields.refuse(at, f"expected {expected}, got none of them")
        return None

    def optional(name: str, kind: Kind) -> Value | None:
        text = getattr(table, name)
        return None if text is None else fields.value(f"{at}.{name}", text, kind)

    area = optional("radiating_area", AREA)
    emissivity = optional("emissivity", EMISSIVITY)
    return NonlinearLink(
        convection=optional("convection", CONDUCTANCE),
        exponent=optional("convection_exponent", EXPONENT) or LAMINAR,
        radiating_area=area * emissivity if area and emissivity else area,
        between=(),
    )


def _check_ends(
    pairs: Sequence[tuple[str, str]], bodies: Sequence[Body], at: str, fields: Fields
) -> None:
    """Refuses convection and radiation to a body whose temperature is an input."""
    temperatures = {body.name: body.temperature for body in bodies}
    for end in (end for pair in pairs for end in pair):
        temperature = temperatures.get(end)
        if temperature is not None and fields.depends_on_input(temperature):
            fields.refuse(
                f"{at}.between",
                "expected an end whose temperature is no input beside convection or a "
                f"radiating_area, got {end!r}; give the link a resistance instead",
            )
