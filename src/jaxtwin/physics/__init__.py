"""The physics: netlist, plate, thermoelectric module, driver, camera, and the twin of them all."""

from ._assembly import build_netlist
from ._camera import frame_to_channels, pixel_weights
from ._dc_sweep import DCSweep
from ._driver import Bridge, CellHeat
from ._fault_models import FAULT_MODELS, Fault, FaultModel
from ._faults import Faults, TimedFault
from ._heat_loss import CALM, STEFAN_BOLTZMANN
from ._netlist import Link, Loss, Netlist, Node, Reservoir, ThermoelectricElement
from ._plate_edges import MeasuredRegistration, measure_registration
from ._plate_map import PlateMap, plate_map
from ._sensors import channel_weights
from ._system import System
from ._thermoelectric import ThermoelectricModule
from ._twin import Twin

__all__ = [
    "CALM",
    "FAULT_MODELS",
    "STEFAN_BOLTZMANN",
    "Bridge",
    "CellHeat",
    "DCSweep",
    "Fault",
    "FaultModel",
    "Faults",
    "Link",
    "Loss",
    "MeasuredRegistration",
    "Netlist",
    "Node",
    "PlateMap",
    "Reservoir",
    "System",
    "ThermoelectricElement",
    "ThermoelectricModule",
    "TimedFault",
    "Twin",
    "build_netlist",
    "channel_weights",
    "frame_to_channels",
    "measure_registration",
    "pixel_weights",
    "plate_map",
]
