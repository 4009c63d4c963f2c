"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked."""

from ._body import Body
from ._bundled import bundled_materials, bundled_modules, bundled_rigs
from ._camera import Camera, Channel, CommonError, Registration, Sensors
from ._cell import Cell
from ._circuit import Circuit, CircuitLink
from ._datasheet import Datasheet, load_module
from ._driver import Driver
from ._json_schema import json_schema
from ._load import load_rig
from ._material import Material, load_material
from ._new_rig import CellPlace, new_rig_text
from ._parameter import Parameter
from ._parameter_file import read_parameters, write_parameters
from ._plate import Plate
from ._rig import Rig
from ._value import Value

__all__ = [
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
    "Material",
    "Parameter",
    "Plate",
    "Registration",
    "Rig",
    "Sensors",
    "Value",
    "bundled_materials",
    "bundled_modules",
    "bundled_rigs",
    "json_schema",
    "load_material",
    "load_module",
    "load_rig",
    "new_rig_text",
    "read_parameters",
    "write_parameters",
]
