"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked.

A rig file becomes a `Rig` in three steps: keys and types by pydantic (`_schema`, `_validate`), then
units, names and geometry, part by part (`_build`), then values in SI units. A quantity of the file
is a `Value` (`_value`): a number, or a number times parameters to powers, so that a match can
change it. Which file holds what:

- reading: `_load`, `_build`, `_fields` (texts to values), `_problems` (messages), `_bundled`, and
  `_with_resolution` (the same rig on another grid)
- units: `_units`, and `_common_units` for those that need no pint
- the plate: `_plate`, `_plate_table`, `_grid_table`, `_circuit`, `_circuit_table`, `_material`
- what stands on it: `_cell`, `_cell_table`, `_datasheet`, `_heater`, `_heater_table`, `_body`,
  `_body_table`, `_fan_table`, and `_grounding` (a path for the heat of each of them)
- where cells and heaters lie on it: `_placement`, `_placement_table`, and the areas in `_overlap`
- what drives and reads it: `_driver`, `_limits`, `_camera`, `_bench_table`
- what else changes during a run: `_input`, `_input_table`
- channels: `_channel`; a kind of sensor (`_sensor`) says what it reads, weighs and shows:
  `_nodes_sensor`, `_zone_sensor`, `_point_sensor`, by the means of `_zone_means`
- parameters: `_parameter`, `_parameter_table`, `_parameter_file`
- writing: `_new_rig` and `_example_rig` (a first rig file), `_json_schema` (for editors)
"""

from ._body import Body
from ._bundled import bundled_materials, bundled_modules, bundled_rigs
from ._camera import Camera, CommonError, Registration, Sensors
from ._cell import Cell
from ._channel import Channel
from ._circuit import Circuit, CircuitLink, NonlinearLink
from ._datasheet import Datasheet, load_module
from ._driver import Driver
from ._heater import Heater
from ._input import Input, Switched
from ._json_schema import json_schema
from ._load import load_rig, rig_from_tables
from ._material import Material, load_material
from ._new_rig import CellPlace, HeaterPlace, new_rig_text
from ._nodes_sensor import NodesSensor
from ._parameter import Parameter
from ._parameter_file import read_parameters, write_parameters
from ._placement import Placement
from ._plate import Plate
from ._point_sensor import PointSensor
from ._relay_window import RelayWindow
from ._rig import Rig
from ._sensor import AbstractSensor, SensorSite, register_sensor
from ._units import COORDINATE, LENGTH
from ._value import Value
from ._zone_sensor import ZoneSensor

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
