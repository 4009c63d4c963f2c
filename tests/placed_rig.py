"""A plate of 16 cm x 8 cm with a cell of 4 cm x 4 cm, by its place, and a sensor at its far end."""

import tomllib

from jaxtwin.rig import Rig, rig_from_tables

GRID = 'width = "16 cm"\nheight = "8 cm"\nresolution = "1 cm"'
AT = 'at = ["5 cm", "4 cm"]\nsize = "4 cm"\ncontact_resistance = "R_contact"'
PLACES = """
x_1 = { value = 50.0, unit = "mm", bounds = [30.0, 80.0], free = true }
y_1 = { value = 40.0, unit = "mm", bounds = [29.0, 51.0], free = true }
"""
MOVING = 'at = ["x_1", "y_1"]\nsize = "4 cm"\ncontact_resistance = "R_contact"'

TEXT = """
format = 1
name = "placed"

[plate]
{grid}
thickness = "1 mm"
density = "8960 kg/m^3"
specific_heat = "390 J/(kg K)"
conductivity = "401 W/(m K)"
{losses}

{cells}
{parts}

[sensors]
noise = "0.1 K"

[driver]
supply_voltage = "12 V"
supply_resistance = "0.2 ohm"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"

[[channels]]
name = "T_far"
x = ["12 cm", "16 cm"]
y = ["0 cm", "8 cm"]

[[channels]]
name = "T_near"
x = "7.5 cm"
y = "2.5 cm"

[ambient]
temperature = "20 degC"

[parameters]
R_contact = {{ value = 0.6, unit = "K/W", bounds = [0.02, 40.0], free = true }}
{parameters}
"""

CELL = """
[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "17 J/K"
sink_resistance = "0.5 K/W"
{place}
"""


def placed_text(
    place: str = AT,
    *,
    grid: str = GRID,
    losses: str = 'film_coefficient = "15 W/(m^2 K)"\nfilm_exponent = "0.25"\nemissivity = "0.5"',
    parts: str = "",
    parameters: str = "",
) -> str:
    """The text of the file.

    **Arguments:**

    - `place`: the lines that say where the cell is. `grid`, `losses`: lines of the plate.
    - `parts`: more tables. `parameters`: more parameters.
    """
    moved = PLACES if "x_1" in place and not parameters else parameters
    cells = CELL.format(place=place)
    return TEXT.format(grid=grid, losses=losses, cells=cells, parts=parts, parameters=moved)


def placed_rig(place: str = AT, **parts: str) -> Rig:
    """The rig of the file `placed.toml`: see `placed_text`."""
    return rig_from_tables(tomllib.loads(placed_text(place, **parts)), "placed.toml")
