"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked.

A rig file becomes a `Rig` in three steps (`_build`): keys and types by pydantic (`_schema`), then
units, names and geometry, part by part, then values in SI units. A quantity of the file is a
`Value` (`_value`): a number, or a number times parameters to powers, so that a match can change it.
Which file holds what:

- reading: `_build`, `_fields` (texts to values), `_units`, `_toml` (files and messages), and
  `_variants` (the same rig on another grid, or with cells at other places)
- the plate: `_plate`, `_plate_table`
- what stands on it: `_cell`, `_heater`, and where they lie (`_placement`); `_bodies`, with links
  and circuits
- what drives and reads it: `_instruments`; a kind of sensor (`_sensors`) says what a channel
  reads, weighs and shows, by the means of `_zone_means`
- parameters and other inputs: `_value`, `_parameter_table`, `_parameter_file`
- the whole: `_rig`, and `_plate_needed` for what only a plate has
- writing: `_new_rig` (a first rig file)
"""

from ._bodies import Body, Circuit, CircuitLink, NonlinearLink
from ._build import json_schema, load_rig, rig_from_tables
from ._cell import Cell, Datasheet, load_module
from ._heater import Heater, RelayWindow
from ._instruments import Camera, Channel, CommonError, Driver, Registration, Sensors
from ._new_rig import CellPlace, HeaterPlace, new_rig_text
from ._parameter_file import read_parameters, write_parameters
from ._placement import Placement
from ._plate import Plate
from ._plate_table import Material, load_material
from ._rig import Rig
from ._sensors import (
    AbstractSensor,
    NodesSensor,
    PointSensor,
    SensorSite,
    ZoneSensor,
    register_sensor,
)
from ._toml import bundled_materials, bundled_modules, bundled_rigs
from ._units import COORDINATE, LENGTH
from ._value import Input, Parameter, Switched, Value

__all__ = [
    "COORDINATE",
    "LENGTH",
    "AbstractSensor",
    "Body",
    "Camera",
    "Cell",
    "CellPlace",
    "Channel",
    "Circuit",
    "CircuitLink",
    "CommonError",
    "Datasheet",
    "Driver",
    "Heater",
    "HeaterPlace",
    "Input",
    "Material",
    "NodesSensor",
    "NonlinearLink",
    "Parameter",
    "Placement",
    "Plate",
    "PointSensor",
    "Registration",
    "RelayWindow",
    "Rig",
    "SensorSite",
    "Sensors",
    "Switched",
    "Value",
    "ZoneSensor",
    "bundled_materials",
    "bundled_modules",
    "bundled_rigs",
    "json_schema",
    "load_material",
    "load_module",
    "load_rig",
    "new_rig_text",
    "read_parameters",
    "register_sensor",
    "rig_from_tables",
    "write_parameters",
]
