"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked."""

from ._bundled import bundled_modules, bundled_rigs, read_toml
from ._camera import Camera, Channel, CommonError, Sensors
from ._cell import Cell
from ._circuit import Circuit, CircuitLink
from ._datasheet import Datasheet, load_module
from ._driver import Driver
from ._load import load_rig
from ._parameter import Parameter
from ._parameter_file import (
    parameters_toml,
    read_parameters,
    recording_parameters,
    write_parameters,
)
from ._plate import AMBIENT, FILM_REFERENCE, Plate
from ._problems import refuse, unknown
from ._rig import Rig
from ._value import Value

__all__ = [
    "AMBIENT",
    "FILM_REFERENCE",
    "Camera",
    "Cell",
    "Channel",
    "Circuit",
    "CircuitLink",
    "CommonError",
    "Datasheet",
    "Driver",
    "Parameter",
    "Plate",
    "Rig",
    "Sensors",
    "Value",
    "bundled_modules",
    "bundled_rigs",
    "load_module",
    "load_rig",
    "parameters_toml",
    "read_parameters",
    "read_toml",
    "recording_parameters",
    "refuse",
    "unknown",
    "write_parameters",
]
