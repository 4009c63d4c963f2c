r"""The physics: netlist, plate, thermoelectric module, driver, camera, and the twin of them all.

The temperatures $x$ of the nodes follow $C \dot x = -G x + g a + q(x, u, a)$ with the duty $u$ and
the ambient $a$, and the readings are $y = a + \gamma (W x - a)$: both stand in `_system`. On the
way there a rig becomes a list of nodes and links (`_netlist`), then constant arrays (`_wiring`),
then numbers for one set of parameter values (`System`). Which file holds what:

- the network: `_assembly` (of the parts), `_plate` (finite volumes or a given circuit), `_placed`
  (what follows from the places of cells), `_lumping` (nodes that are always equal), `_expressions`
- heat: `_thermoelectric` (cells, eqs. 7 to 10 of the paper), `_driver` (PWM and bridge),
  `_heat_loss` (films and radiation)
- what is read: `_sensors` (weights, lags), `_camera` (pixels), `_registration` (where the camera
  looks, by the edges of the plate in a frame), `_recalibrations`, `_plate_map`
- inputs besides the duty: `_input_effects`, the links and values that they change
- the twin: `_twin`, a rig with values
- faults: `_fault_models`, functions `System -> System`, and `_faults`, when they happen
"""

from ._assembly import build_netlist
from ._camera import frame_to_channels, pixel_weights
from ._driver import Bridge, CellHeat
from ._fault_models import FAULT_MODELS, Fault, FaultModel
from ._faults import Faults, TimedFault
from ._heat_loss import CALM, STEFAN_BOLTZMANN
from ._netlist import Link, Loss, Netlist, Node, Reservoir, ThermoelectricElement
from ._plate_map import PlateMap, plate_map
from ._registration import MeasuredRegistration, measure_registration
from ._sensors import channel_weights
from ._system import System
from ._thermoelectric import DCSweep, ThermoelectricModule
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
