"""Thermoelectric cells, their datasheets, and the tables `[[cells]]` of a rig file."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, final

from ._bodies import Body, blown
from ._fields import Fields
from ._placement import Placement, build_placement, placed_contacts
from ._plate import Plate
from ._toml import bundled_modules, read_bundled
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
from ._value import Switched, Value

if TYPE_CHECKING:
    from ._schema import CellTable


@final
@dataclass(frozen=True)
class Cell:
    """A thermoelectric cell between the plate and a sink, Fig. 9b of the paper.

    **Arguments:**

    - `name`: unique in the rig.
    - `seebeck_coefficient`: the Seebeck coefficient of the whole module, V/K.
    - `electrical_resistance`: ohm.
    - `thermal_resistance`: between the two sides, K/W.
    - `side_capacitance`: the heat capacity of each side, J/K.
    - `contacts`: pairs (plate element or body, contact resistance to the plate side in K/W).
    - `sink_resistance`: the resistance from the far side to the surroundings, or to the sink's mass
      if it has one, K/W; None for a far side that is isolated.
    - `sink`: the body that replaces the surroundings as the other end of this resistance; None for
      the surroundings.
    - `sink_capacitance`, `sink_air_resistance`: the sink's mass (J/K) and its resistance to the
      surroundings (K/W), which is None if the sink is isolated.
    - `initial_temperature`: the initial temperature of both sides, K; None means that each side
      starts at the temperature of the plate or of the sink, which it touches.
    - `sink_initial_temperature`: the initial temperature of the sink, K; None means that of the
      plate.
    - `area`: the area of the plate that the cell covers, m^2; None for that of one of the elements
      that it touches, on average.
    - `placement`: its place on the plate, from which its contacts and the area that it covers
      follow; None if the file lists contacts.
    - `full_scale`: what a column of a recording in W, V or A has at full duty: the number and this
      unit; None for recordings of the duty.
    """

    name: str
    seebeck_coefficient: Value
    electrical_resistance: Value
    thermal_resistance: Value
    side_capacitance: Value
    contacts: tuple[tuple[str, Value], ...]
    sink_resistance: Value | Switched | None = None
    sink_capacitance: Value | None = None
    sink_air_resistance: Value | Switched | None = None
    initial_temperature: Value | None = None
    sink_initial_temperature: Value | None = None
    sink: str | None = None
    area: float | None = None
    placement: Placement | None = None
    # A matter of recordings, not of temperatures, and so no part of the fingerprint.
    full_scale: tuple[float, str] | None = field(default=None, repr=False)


@final
@dataclass(frozen=True)
class Datasheet:
    r"""The datasheet of a thermoelectric module.

    **Arguments:**

    - `name`, `title`, `references`, `notes`: its name, a title, the sources of the numbers, and
      notes.
    - `hot_side_temperature`: $T_h$, the temperature of the hot side for which the other numbers are
      stated, K.
    - `maximum_current`, `maximum_voltage`: $I_{max}$ (A) and $V_{max}$ (V), at which the
      temperature difference without load is largest.
    - `maximum_temperature_difference`: $\Delta T_{max}$, K.
    - `maximum_heat_flow`: the heat flow that is absorbed at $I_{max}$ without a temperature
      difference, W; None if not known.
    - `ac_resistance`: the resistance measured with alternating current, without a temperature
      difference, ohm; None if not known.
    - `mass`: kg; None if not known.
    - `width`, `height`: width and height of its faces, m; None if not known.

    The constants follow from eq. (10) of the paper.
    """

    name: str
    title: str
    references: tuple[str, ...]
    notes: str
    hot_side_temperature: float
    maximum_voltage: float
    maximum_current: float
    maximum_temperature_difference: float
    maximum_heat_flow: float | None = None
    ac_resistance: float | None = None
    mass: float | None = None
    width: float | None = None
    height: float | None = None

    @property
    def seebeck_coefficient(self) -> float:
        r"""$\alpha = V_{max} / T_h$, V/K."""
        return self.maximum_voltage / self.hot_side_temperature

    @property
    def electrical_resistance(self) -> float:
        r"""$R_E = (V_{max} / I_{max}) (T_h - \Delta T_{max}) / T_h$, ohm."""
        lowest = self.hot_side_temperature - self.maximum_temperature_difference
        return self.maximum_voltage / self.maximum_current * lowest / self.hot_side_temperature

    @property
    def thermal_resistance(self) -> float:
        r"""The thermal resistance of the module, K/W:

        $$R_{Th} = \frac{\Delta T_{max}}{I_{max} V_{max}} \frac{2 T_h}{T_h - \Delta T_{max}}$$
        """
        lowest = self.hot_side_temperature - self.maximum_temperature_difference
        power = self.maximum_voltage * self.maximum_current
        return self.maximum_temperature_difference / power * 2 * self.hot_side_temperature / lowest


def load_module(name: str) -> Datasheet:
    """Loads a bundled datasheet.

    **Arguments:**

    - `name`: one of `bundled_modules()`.

    **Raises:** `RigError` if no datasheet has this name.
    """
    # pydantic and pint take a while to import, and only readers of a file should pay for them.
    from . import _units as units
    from ._fields import Fields
    from ._schema import ModuleTable, validate

    data, source = read_bundled("modules", name)
    table = validate(ModuleTable, data, source)
    fields = Fields(source, {}, {})

    def number(field: str, kind: units.Kind) -> float:
        return fields.constant(field, getattr(table, field), kind)

    def optional(field: str, kind: units.Kind) -> float | None:
        return None if getattr(table, field) is None else number(field, kind)

    return Datasheet(
        name=table.name,
        title=table.title,
        references=tuple(table.references),
        notes=table.notes,
        hot_side_temperature=number("hot_side_temperature", units.TEMPERATURE),
        maximum_voltage=number("maximum_voltage", units.VOLTAGE),
        maximum_current=number("maximum_current", units.CURRENT),
        maximum_temperature_difference=number(
            "maximum_temperature_difference", units.TEMPERATURE_DIFFERENCE
        ),
        maximum_heat_flow=optional("maximum_heat_flow", units.POWER),
        ac_resistance=optional("ac_resistance", units.ELECTRICAL_RESISTANCE),
        mass=optional("mass", units.MASS),
        width=optional("width", units.LENGTH),
        height=optional("height", units.LENGTH),
    )


def build_cell(table: "CellTable", plate: Plate, bodies: Sequence[Body], fields: Fields) -> Cell:
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

    optional = partial(fields.optional, at, table)

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
    table: "CellTable", plate: Plate, bodies: Sequence[str], fields: Fields
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


def _area(table: "CellTable", plate: Plate, fields: Fields) -> float | None:
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


def _side_capacitance(table: "CellTable", fields: Fields) -> Value:
    at = f"cells[{table.name}]"
    whole, mass, specific_heat = table.side_capacitance, table.side_mass, table.side_specific_heat
    if whole is not None and mass is None and specific_heat is None:
        return fields.value(f"{at}.side_capacitance", whole, HEAT_CAPACITY)
    if whole is not None or mass is None or specific_heat is None:
        fields.refuse(at, "expected either side_capacitance or side_mass with side_specific_heat")
    return fields.value(f"{at}.side_mass", mass, MASS) * fields.value(
        f"{at}.side_specific_heat", specific_heat, SPECIFIC_HEAT
    )
