"""Rigs: plate, cells, driver, camera and parameters, read from rig files and checked."""

from ._camera import Camera, Channel
from ._cell import Cell
from ._circuit import Circuit, CircuitLink
from ._driver import Driver
from ._parameter import Parameter
from ._plate import AMBIENT, Plate
from ._rig import Rig
from ._value import Value

__all__ = [
    "AMBIENT",
    "Camera",
    "Cell",
    "Channel",
    "Circuit",
    "CircuitLink",
    "Driver",
    "Parameter",
    "Plate",
    "Rig",
    "Value",
]
