"""Builds cells from the tables `[[cells]]` of a rig file."""

from collections.abc import Sequence

from ._body import Body
from ._bundled import bundled_modules
from ._cell import Cell
from ._datasheet import load_module
from ._fan_table import blown
from ._fields import Fields
from ._input import Switched
from ._placement_table import build_placement, placed_contacts
from ._plate import Plate
from ._schema import CellTable
from ._units import (
    AREA,
    ELECTRICAL_RESISTANCE,
    HEAT_CAPACITY,
    MASS,
    SEEBECK_COEFFICIENT,
    SPECIFIC_HEAT,
    TEMPERATURE,
    THERMAL_RESISTANCE,
    Kind,
)
from ._value import Value


def build_cell(table: CellTable, plate: Plate, bodies: Sequence[Body], fields: Fields) -> Cell:
    """Builds a cell. Constants that the file does not state are those of the datasheet of its
    module.

    **Raises:** `RigError` if a value is wrong or missing, a contact is on neither an element nor a
    body, or the sink is none of the bodies.
    """
    at = f"cells[{table.name}]"
    if table.module is not None:
        fields.check_known(f"{at}.module", "module", table.module, bundled_modules())
    free = [body.name for body in bodies if body.temperature is None]
    placement = build_placement(at, table, plate, fields)
    if placement is None:
        contacts = _listed_contacts(table, plate, free, fields)
    else:
        contacts = placed_contacts(at, table, placement, plate, fields)
    if table.sink is not None:
        fields.check_known(f"{at}.sink", "body", table.sink, [body.name for body in bodies])
        for name in ("sink_capacitance", "sink_initial_temperature", "fan"):
            if getattr(table, name) is not None:
                fields.refuse(
                    f"{at}.{name}",
                    "expected none beside a sink; give it to the body or its link instead",
                )
    if table.sink_resistance is None:
        for name in ("sink", "sink_capacitance"):
            if getattr(table, name) is not None:
                fields.refuse(
                    f"{at}.sink_resistance", f"expected a value beside {name}, got none; give it"
                )
    if (table.sink_capacitance is None) != (table.sink_air_resistance is None):
        fields.refuse(
            at, "expected both or neither of sink_capacitance and sink_air_resistance, got one"
        )

    if table.fan is not None and table.sink_air_resistance is None:
        fields.refuse(
            f"{at}.fan",
            "expected a sink_air_resistance beside a fan, got none; give it, which the fan lowers",
        )

    def optional(name: str, kind: Kind) -> Value | None:
        text = getattr(table, name)
        return None if text is None else fields.value(f"{at}.{name}", text, kind)

    def constant(name: str, kind: Kind) -> Value:
        given = optional(name, kind)
        if given is not None:
            return given
        if table.module is None:
            fields.refuse(f"{at}.{name}", "expected a value, got none; give it, or name a module")
        return Value(getattr(load_module(table.module), name))

    def path(name: str) -> Value | Switched | None:
        given = getattr(table, name)
        return None if given is None else fields.varying_path(f"{at}.{name}", given)

    to_air = path("sink_air_resistance")
    return Cell(
        name=table.name,
        seebeck_coefficient=constant("seebeck_coefficient", SEEBECK_COEFFICIENT),
        electrical_resistance=constant("electrical_resistance", ELECTRICAL_RESISTANCE),
        thermal_resistance=constant("thermal_resistance", THERMAL_RESISTANCE),
        side_capacitance=_side_capacitance(table, fields),
        contacts=contacts,
        sink_resistance=path("sink_resistance"),
        sink_capacitance=optional("sink_capacitance", HEAT_CAPACITY),
        sink_air_resistance=to_air and blown(to_air, table.fan, at, fields),
        initial_temperature=optional("initial_temperature", TEMPERATURE),
        sink_initial_temperature=optional("sink_initial_temperature", TEMPERATURE),
        sink=table.sink,
        area=_area(table, plate, fields),
        placement=placement,
        full_scale=fields.full_scale(f"{at}.full_scale", table.full_scale),
    )


def _listed_contacts(
    table: CellTable, plate: Plate, bodies: Sequence[str], fields: Fields
) -> tuple[tuple[str, Value], ...]:
    """The contacts that the file lists by element or body, without those of no conductance."""
    at = f"cells[{table.name}].contacts"
    if table.contacts is None:
        fields.refuse(
            at,
            'expected contacts such as { V11 = "0.6 K/W" }, or a place such as '
            'at = ["6 cm", "4 cm"] with size and contact_resistance, got neither',
        )
    for node in table.contacts:
        fields.check_element(at, node, plate.element_names, bodies)
    given = {node: fields.path(f"{at}.{node}", text) for node, text in table.contacts.items()}
    contacts = tuple((node, value) for node, value in given.items() if value is not None)
    if not contacts:
        fields.refuse(at, "expected a finite resistance, got none")
    return contacts


def _area(table: CellTable, plate: Plate, fields: Fields) -> float | None:
    if table.area is None:
        return None
    at = f"cells[{table.name}].area"
    if plate.film_coefficient is None:
        fields.refuse(at, "expected none beside a [circuit], whose links are the plate's losses")
    if table.contacts is None:
        fields.refuse(at, "expected none beside at, whose size is the area; remove it")
    area = fields.constant(at, table.area, AREA)
    elements = [element for element in table.contacts if element in plate.element_names]
    touched = sum(plate.area(element) for element in elements)
    if area > touched * (1 + 1e-6):
        fields.refuse(
            at,
            f"expected at most {1e4 * touched:g} cm^2, the area of the elements in contacts, got "
            f"{table.area!r}",
        )
    return min(area, touched)


def _side_capacitance(table: CellTable, fields: Fields) -> Value:
    at = f"cells[{table.name}]"
    whole, mass, specific_heat = table.side_capacitance, table.side_mass, table.side_specific_heat
    if whole is not None and mass is None and specific_heat is None:
        return fields.value(f"{at}.side_capacitance", whole, HEAT_CAPACITY)
    if whole is not None or mass is None or specific_heat is None:
        fields.refuse(at, "expected either side_capacitance or side_mass with side_specific_heat")
    return fields.value(f"{at}.side_mass", mass, MASS) * fields.value(
        f"{at}.side_specific_heat", specific_heat, SPECIFIC_HEAT
    )
