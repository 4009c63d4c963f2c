"""Writes a rig file for a rig of which little is known: sizes are measured with a ruler, other
values are from handbooks.

Each uncertain value becomes a free parameter, with a prior as wide as its uncertainty.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from . import _units as units
from ._build import load_rig
from ._cell import Datasheet, load_module
from ._fields import Fields
from ._plate import Plate, load_material
from ._rig import Rig
from ._toml import bundled_content, bundled_materials, bundled_modules, bundled_rigs
from ._value import Value

# The size of the plate's elements, m; it is larger on large plates.
ELEMENT = 0.01

# The largest number of elements along a side.
MAX_ELEMENTS = 16

# Thermal resistance of a layer of thermal grease, 50 um at 1 W/(m K), m^2 K/W.
GREASE = 0.5e-4

# Heat capacity of a module's side, J/(m^2 K): 0.7 mm of aluminium oxide.
CERAMIC = 2.1e3

# The length of the side of a module whose datasheet does not state it, m.
FACE = 0.04

MOST_CELLS, MOST_ZONES = 100, 100


class CellPlace(NamedTuple):
    """The centre of a cell, from the left and from the top edge: `"2 cm"`, `"1 cm"`."""

    x: str
    y: str


class HeaterPlace(NamedTuple):
    """A small heater: its name, its power at full duty and its place, from the left and from the
    top edge: `"foil"`, `"10 W"`, `"2 cm"`, `"1 cm"`."""

    name: str
    power: str
    x: str
    y: str


def new_rig_text(
    name: str,
    *,
    width: str,
    height: str,
    thickness: str,
    material: str,
    module: str,
    places: Sequence[CellPlace],
    heaters: Sequence[HeaterPlace] = (),
    zones: tuple[int, int] = (3, 2),
    supply_voltage: str = "12 V",
    limit: str = "80 degC",
    reader: Literal["camera", "sensors"] = "camera",
) -> str:
    """Writes a commented rig file.

    **Arguments:**

    - `name`: the name of the rig.
    - `width`, `height`, `thickness`: the sizes of the plate, such as `"8 cm"`.
    - `material`: the material of the plate, one of `bundled_materials()`.
    - `module`: the datasheet of its cells, one of `bundled_modules()`.
    - `places`: the positions of the cells' centres on the plate. A comment in the file says where
      the edges of a module do not lie on those of elements.
    - `heaters`: heaters beside the cells. The heat of each goes into the element under its place.
    - `zones`: columns and rows of zones into which the plate is divided; each is a channel.
    - `supply_voltage`: the supply voltage of the driver.
    - `limit`: the temperature at which `jaxtwin drive` switches the cells off.
    - `reader`: `"camera"` for the means of the zones, `"sensors"` for points in their middle.

    **Returns:** the text of the file, which `load_rig` reads.

    **Raises:** `RigError` that names the argument if a size has no unit, a name is not known, a
    cell or heater is beside the plate, two cells cover each other, or a heater has no name of its
    own.
    """
    fields = Fields("new rig", {}, {})
    plain = name.strip()
    if not plain or not plain.isprintable():
        fields.refuse("name", f"expected text on one line, got {name!r}")
    sizes = {
        argument: plate_size(fields, argument, text)
        for argument, text in (("width", width), ("height", height), ("thickness", thickness))
    }
    fields.constant("supply_voltage", supply_voltage, units.VOLTAGE)
    fields.constant("limit", limit, units.TEMPERATURE)
    fields.check_known("material", "material", material, bundled_materials())
    fields.check_known("module", "module", module, bundled_modules())
    if reader not in ("camera", "sensors"):
        fields.refuse("reader", f"expected camera or sensors, got {reader!r}")
    check_zones(fields, zones)
    plate = divided_plate(**sizes)
    columns, rows = ((len(sides), sides[0]) for sides in (plate.columns, plate.rows))
    sheet = load_module(module)
    cells = covered_elements(fields, places, sheet, plate)
    heated = heated_elements(fields, heaters, plate, len(places))
    solid, names = load_material(material), [heater.name for heater in heaters]
    face = math.prod(_face(sheet))
    areas = [min(face, sum(map(plate.area, cell))) for cell in cells]
    values = {
        "name": _quoted(plain),
        "title": _quoted(", ".join([f"{solid.title} plate", f"{len(places)} x {module}", *names])),
        "columns": ", ".join([f'"{_mm(columns[1])}"'] * columns[0]),
        "rows": ", ".join([f'"{_mm(rows[1])}"'] * rows[0]),
        "thickness": f"{1e3 * sizes['thickness']:.9g} mm",
        "material": solid.title,
        "material_source": "; ".join(solid.references),
        "density": f"{solid.density:g}",
        "specific_heat": f"{solid.specific_heat:g}",
        "conductivity": f"{solid.conductivity:g}",
        "least_conductivity": f"{solid.conductivity / 10:g}",
        "most_conductivity": f"{solid.conductivity * 10:g}",
        "least_heat": f"{solid.specific_heat / 5:g}",
        "most_heat": f"{solid.specific_heat * 5:g}",
        "module": module,
        "module_source": "; ".join(sheet.references),
        "alpha": f"{sheet.seebeck_coefficient:.4g}",
        "R_E": f"{sheet.electrical_resistance:.4g}",
        "R_Th": f"{sheet.thermal_resistance:.4g}",
        "C_side": f"{CERAMIC * face:.3g}",
        "supply_voltage": supply_voltage,
        "limit": limit,
        "reader": _reader(reader, sizes["width"], sizes["height"]),
        "cells": "\n".join(
            _cell_table(number, cell, area, misfit(plate, cell, sheet))
            for number, (cell, area) in enumerate(zip(cells, areas, strict=True), 1)
        ),
        "heaters": _heater_tables(heaters, heated),
        "polarity": OF_HEATERS if heaters else OF_CELLS,
        "powers": "".join(_power_parameter(fields, heater) for heater in heaters),
        "channels": "\n".join(_channel_tables(reader, zones, columns, rows)),
        "contacts": "\n".join(
            # All elements together have the contact of the face, also where they are larger.
            _contact_parameter(number, GREASE * len(cell) / area)
            for number, (cell, area) in enumerate(zip(cells, areas, strict=True), 1)
        ),
    }
    return TEMPLATE.format(**values)


def plate_size(fields: Fields, argument: str, text: str) -> float:
    """The width, height or thickness of a plate, m.

    **Raises:** `RigError` that names the argument if it is no length, or a width or height that
    an editor and the reader of the file would stumble over.
    """
    size = fields.constant(argument, text, units.LENGTH)
    if argument != "thickness" and not 1e-3 <= size <= 10:
        fields.refuse(argument, f"expected 1 mm to 10 m, got {text!r}")
    return size


def check_zones(fields: Fields, zones: tuple[int, int]) -> None:
    """Checks the numbers of columns and rows of zones.

    **Raises:** `RigError` if there is none, or too many.
    """
    for number, argument in zip(zones, ("columns", "rows"), strict=True):
        if not 1 <= number <= MOST_ZONES:
            fields.refuse("zones", f"expected 1 to {MOST_ZONES} {argument}, got {number}")


def divided_plate(width: float, height: float, thickness: float) -> Plate:
    """The plate divided into elements of equal size, which are rounded to a nanometre. Only its
    sizes, m, are known yet."""

    def divided(size: float) -> tuple[float, ...]:
        count = max(1, min(MAX_ELEMENTS, round(size / ELEMENT)))
        return (round(size / count, 9),) * count

    return Plate(divided(width), divided(height), thickness=Value(thickness))


def _face(sheet: Datasheet) -> tuple[float, float]:
    """Width and height of the face of a module, m."""
    return sheet.width or FACE, sheet.height or FACE


def misfit(plate: Plate, elements: Sequence[str], sheet: Datasheet) -> str | None:
    """What to say if the elements that a module touches are wider or narrower than its face by more
    than a tenth of an element, because its edges lie inside of elements; None if they are not.

    **Arguments:**

    - `elements`: the names of the elements.
    - `sheet`: the module's datasheet.
    """
    corners = [plate.extent(element) for element in elements]
    left, _, top, _ = map(min, zip(*corners, strict=True))
    _, right, _, bottom = map(max, zip(*corners, strict=True))
    touched, face = (right - left, bottom - top), _face(sheet)
    sides = (plate.columns[0], plate.rows[0])
    if all(abs(a - b) < 0.1 * c for a, b, c in zip(touched, face, sides, strict=True)):
        return None
    return (
        f"its face is {_by(face)}, but the elements that it touches are {_by(touched)}, so its "
        "edges, and gaps beside them, are not where they are on the plate; columns and rows with "
        "edges at those of the module mend this"
    )


def _by(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.4g} mm x {1e3 * sizes[1]:.4g} mm"


def covered_elements(
    fields: Fields, places: Sequence[CellPlace], sheet: Datasheet, plate: Plate
) -> list[list[str]]:
    """Returns the elements that each cell covers: those whose centre lies under it, and at least
    one.

    **Raises:** `RigError` if there is no cell or too many, one is beside the plate, or two cover
    each other.
    """
    if not 1 <= len(places) <= MOST_CELLS:
        fields.refuse("places", f"expected 1 to {MOST_CELLS} cells, got {len(places)}")
    columns, rows = plate.columns, plate.rows
    taken: dict[str, int] = {}
    cells = []
    for number, place in enumerate(places, start=1):
        covered = []
        for text, sides, face, axis in zip(place, (columns, rows), _face(sheet), "xy", strict=True):
            count, size = len(sides), sides[0]
            at = fields.constant(f"cell {number}: {axis}", text, units.COORDINATE)
            if at > count * size * (1 + 1e-6):
                fields.refuse(
                    f"cell {number}: {axis}",
                    f"expected a place on the plate, 0 to {100 * count * size:g} cm, got {text!r}",
                )
            half = face / 2
            centres = [(k + 0.5) * size for k in range(count)]
            under = [k for k, centre in enumerate(centres) if abs(centre - at) <= half + 1e-9]
            covered.append(under or [min(count - 1, int(at / size))])
        names = [
            plate.element_names[row * len(columns) + column]
            for row in covered[1]
            for column in covered[0]
        ]
        for element in names:
            if element in taken:
                fields.refuse(
                    f"cell {number}",
                    f"expected cells beside each other, got cells {taken[element]} and {number} "
                    f"both on the element {element}; move one of them",
                )
            taken[element] = number
        cells.append(names)
    return cells


def heated_elements(
    fields: Fields, heaters: Sequence[HeaterPlace], plate: Plate, cells: int
) -> list[str]:
    """Returns the element that each heater heats, the one under its place.

    **Raises:** `RigError` if one is beside the plate, has no power, or no name of its own.
    """
    taken = {f"P{number}" for number in range(1, cells + 1)}
    heated = []
    for number, heater in enumerate(heaters, start=1):
        at = f"heater {number}"
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", heater.name):
            fields.refuse(f"{at}: name", f"expected letters, digits and _, got {heater.name!r}")
        if heater.name in taken or heater.name in plate.element_names:
            fields.refuse(
                f"{at}: name",
                f"expected a name of its own, got {heater.name!r}, which a cell, an element or a "
                "heater before it has",
            )
        taken.add(heater.name)
        fields.constant(f"{at}: power", heater.power, units.HEATER_POWER)
        place = []
        for text, sides, axis in (
            (heater.x, plate.columns, "x"),
            (heater.y, plate.rows, "y"),
        ):
            where = fields.constant(f"{at}: {axis}", text, units.COORDINATE)
            length = len(sides) * sides[0]
            if where > length * (1 + 1e-6):
                fields.refuse(
                    f"{at}: {axis}",
                    f"expected a place on the plate, 0 to {100 * length:g} cm, got {text!r}",
                )
            place.append(min(len(sides) - 1, int(where / sides[0])))
        heated.append(plate.element_names[place[1] * len(plate.columns) + place[0]])
    return heated


def _heater_tables(heaters: Sequence[HeaterPlace], elements: Sequence[str]) -> str:
    if not heaters:
        return ""
    tables = [
        f'[[heaters]]\nname = "{heater.name}"\n'
        f'power = "P_{heater.name}"\ncontacts = ["{element}"]\n'
        for heater, element in zip(heaters, elements, strict=True)
    ]
    return "\n".join([ABOUT_HEATERS, *tables])


def _power_parameter(fields: Fields, heater: HeaterPlace) -> str:
    power = fields.constant(f"heater {heater.name}: power", heater.power, units.HEATER_POWER)
    return (
        f'P_{heater.name} = {{ value = {power:.9g}, unit = "W", bounds = [{power / 10:.4g}, '
        f"{power * 10:.4g}], prior = {{ spread = 0.1 }}, free = true, "
        f'description = "power of {heater.name} at full duty" }}\n'
    )


def _reader(reader: str, width: float, height: float) -> str:
    if reader == "sensors":
        return '# Point sensors, such as thermocouples.\n[sensors]\nnoise = "0.1 K"'
    # The plate as large as it gets in the picture.
    scale = min(80 / width, 60 / height)
    half_width, half_height = min(40.0, scale * width / 2), min(30.0, scale * height / 2)
    return (
        "# Where the plate lies in a frame of the camera, pixels: change it to what it sees.\n"
        '[camera]\nresolution = [80, 60]\nnoise = "0.1 K"\n'
        f"view = {{ x = [{40 - half_width:.4g}, {40 + half_width:.4g}], "
        f"y = [{30 - half_height:.4g}, {30 + half_height:.4g}] }}"
    )


def _cell_table(number: int, elements: list[str], area: float, note: str | None) -> str:
    contacts = ", ".join(f'{element} = "R_pc_{number}"' for element in elements)
    comment = f"# P{number}: {note}.\n" if note else ""
    return f"""{comment}[[cells]]
name = "P{number}"
seebeck_coefficient = "alpha"
electrical_resistance = "R_E"
thermal_resistance = "R_Th"
side_capacitance = "C_side"
contacts = {{ {contacts} }}
area = "{1e4 * area:.9g} cm^2"
sink_resistance = "R_sink"
"""


def _channel_tables(
    reader: str, zones: tuple[int, int], columns: tuple[int, float], rows: tuple[int, float]
) -> list[str]:
    width, height = (count * size for count, size in (columns, rows))
    tables = []
    for row in range(zones[1]):
        for column in range(zones[0]):
            label = f"T{row + 1}{column + 1}" if max(zones) < 10 else f"T{row + 1}_{column + 1}"
            x = [_mm(width * (column + part) / zones[0]) for part in (0, 0.5, 1)]
            y = [_mm(height * (row + part) / zones[1]) for part in (0, 0.5, 1)]
            place = f'x = "{x[1]}"\ny = "{y[1]}"'
            if reader == "camera":
                place = f'x = ["{x[0]}", "{x[2]}"]\ny = ["{y[0]}", "{y[2]}"]'
            tables.append(f'[[channels]]\nname = "{label}"\n{place}\n')
    return tables


def _contact_parameter(number: int, value: float) -> str:
    return (
        f'R_pc_{number} = {{ value = {value:.4g}, unit = "K/W", bounds = [{value / 100:.4g}, '
        f"{value * 100:.4g}], prior = {{ spread = 1.0 }}, free = true, "
        f'description = "contact of cell {number} to each element under it" }}'
    )


def _mm(size: float) -> str:
    return f"{math.floor(1e9 * size + 0.5) / 1e6:.9g} mm"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


ABOUT_HEATERS = """\
# Heaters, with a duty of 0 to 1, and the element that each of them heats. One that is larger, or
# stores heat, has capacitance, at, size and contact_resistance in place of contacts. One behind a
# relay has a window: time_proportional = { period = "20 s", minimum_on = "2 s" }."""

OF_CELLS = "# Where positive commands cool the plate, set polarity = -1."
OF_HEATERS = (
    "\n# Positive counts heat: where they cool with the cells, let the device reverse those."
)

TEMPLATE = """\
# A rig file made by 'jaxtwin new-rig'. It is a start: sizes are yours, all else is from handbooks and
# datasheets, or a guess with a prior as wide as the ignorance. 'jaxtwin check' checks it after every
# change, 'jaxtwin match' finds the free parameters from recordings.

format = 1
name = {name}
title = {title}

# The plate, divided into elements: the widths of its columns and the heights of its rows.
# {material}: {material_source}.
[plate]
columns = [{columns}]
rows = [{rows}]
thickness = "{thickness}"
density = "{density} kg/m^3"
specific_heat = "c_plate"
conductivity = "k_plate"
film_coefficient = "h"
# Natural convection grows with the temperature difference, about to this power.
film_exponent = "0.25"

# The cells, the elements that each of them touches, and the area that it covers.
# {module}: {module_source}.
{cells}
{heaters}{polarity}
[driver]
supply_voltage = "{supply_voltage}"
supply_resistance = "R_supply"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"
off_phase = "brake"

{reader}

# What is recorded: columns of zones from the left, rows from the top.
{channels}
[ambient]
temperature = "T_amb"

[initial]
temperature = "T_amb"

# 'jaxtwin drive' switches the cells off above this temperature of any channel.
[limits]
temperature = "{limit}"

# Bounds, and priors with a relative standard deviation, of what a match may change.
[parameters]
c_plate = {{ value = {specific_heat}, unit = "J/(kg K)", bounds = [{least_heat}, {most_heat}], prior = {{ spread = 0.05 }}, free = true, description = "specific heat of the plate" }}
k_plate = {{ value = {conductivity}, unit = "W/(m K)", bounds = [{least_conductivity}, {most_conductivity}], prior = {{ spread = 0.1 }}, free = true, description = "conductivity of the plate" }}
# Natural convection and radiation at a rise of 20 K; more with a fan.
h = {{ value = 15.0, unit = "W/(m^2 K)", bounds = [2.0, 200.0], prior = {{ spread = 0.7 }}, free = true, description = "film coefficient of both faces" }}
# From the datasheet by the usual formulas; modules scatter, and its figures are for another temperature.
alpha = {{ value = {alpha}, unit = "V/K", bounds = [0.001, 1.0], prior = {{ spread = 0.15 }}, free = true, description = "Seebeck coefficient of a cell" }}
R_E = {{ value = {R_E}, unit = "ohm", bounds = [0.01, 100.0], prior = {{ spread = 0.2 }}, free = true, description = "electrical resistance of a cell" }}
R_Th = {{ value = {R_Th}, unit = "K/W", bounds = [0.01, 100.0], prior = {{ spread = 0.2 }}, free = true, description = "between the two sides of a cell" }}
# 0.7 mm of aluminium oxide.
C_side = {{ value = {C_side}, unit = "J/K", bounds = [0.01, 1000.0], prior = {{ spread = 0.5 }}, free = true, description = "heat capacity of a cell side" }}
# 50 um of thermal grease at 1 W/(m K).
{contacts}
# A finned sink with a fan has 0.1 to 0.5 K/W, without a fan 1 to 5 K/W.
R_sink = {{ value = 0.5, unit = "K/W", bounds = [0.01, 20.0], prior = {{ spread = 1.0 }}, free = true, description = "far side of a cell to the air" }}
{powers}R_supply = {{ value = 0.2, unit = "ohm", bounds = [0.005, 5.0], prior = {{ spread = 1.0 }}, free = true, description = "in series with a cell while it is on" }}
T_amb = {{ value = 20.0, unit = "degC", bounds = [-10.0, 45.0], prior = {{ spread = 5.0 }}, free = true, scope = "recording", description = "room" }}
"""  # noqa: E501 (lines of the file)


def example_rigs() -> tuple[str, ...]:
    """The bundled rigs without a plate."""
    return tuple(name for name in bundled_rigs() if not load_rig(name).has_plate)


def example_rig_text(name: str, example: str, values: Mapping[str, float]) -> str:
    """The text of a bundled rig's file, for a rig with another name and other numbers.

    **Arguments:**

    - `name`: the name of the rig.
    - `example`: one of `example_rigs()`.
    - `values`: values of some of its parameters, in the units of its table, which `check_value`
      accepts.
    """
    content, _ = bundled_content("rigs", example)
    text = content.decode("utf-8").replace("\r\n", "\n")
    text = re.sub(r'(?m)^name = ".*"$', lambda _: f'name = "{name}"', text, count=1)
    for parameter, value in values.items():
        # Digits of the number alone; prior and description stay.
        text = re.sub(
            rf"(?m)^({parameter} = {{ value = )[^,]+", rf"\g<1>{float(value)!r}", text, count=1
        )
    return text


def check_value(rig: Rig, parameter: str, value: float, fields: Fields) -> None:
    """Refuses a parameter that the rig does not have, or a value outside its bounds."""
    fields.check_known("value", "parameter", parameter, rig.parameters)
    row = rig.parameters[parameter]
    if not row.lower <= value <= row.upper:
        fields.refuse(
            f"value.{parameter}",
            f"expected {row.lower:g} to {row.upper:g} {row.unit}, got {value:g}; wider bounds are "
            "for an editor",
        )
