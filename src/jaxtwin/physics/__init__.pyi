# Public names of jaxtwin.physics. `__init__.py` imports each when it is first used.

from ._assembly import build_netlist as build_netlist
from ._driver import Bridge as Bridge
from ._driver import CellHeat as CellHeat
from ._fault_models import FAULT_MODELS as FAULT_MODELS
from ._fault_models import Fault as Fault
from ._fault_models import FaultModel as FaultModel
from ._faults import Faults as Faults
from ._faults import TimedFault as TimedFault
from ._heat_loss import MIN_FILM_RISE as MIN_FILM_RISE
from ._heat_loss import STEFAN_BOLTZMANN as STEFAN_BOLTZMANN
from ._netlist import Link as Link
from ._netlist import Loss as Loss
from ._netlist import Netlist as Netlist
from ._netlist import Node as Node
from ._netlist import Reservoir as Reservoir
from ._netlist import ThermoelectricElement as ThermoelectricElement
from ._plate_map import PlateMap as PlateMap
from ._plate_map import plate_map as plate_map
from ._registration import MeasuredRegistration as MeasuredRegistration
from ._registration import measure_registration as measure_registration
from ._sensors import channel_weights as channel_weights
from ._sensors import frame_to_channels as frame_to_channels
from ._sensors import pixel_weights as pixel_weights
from ._system import System as System
from ._thermoelectric import DCSweep as DCSweep
from ._thermoelectric import ThermoelectricModule as ThermoelectricModule
from ._twin import Twin as Twin

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from ._expressions import Expressions as Expressions
from ._heat_loss import LAW_FOLDER as LAW_FOLDER
from ._heat_loss import NonlinearLoss as NonlinearLoss
from ._input_effects import Conditions as Conditions
from ._netlist import OWN_VOLTAGE as OWN_VOLTAGE
from ._netlist import network_counts as network_counts
from ._netlist import network_text as network_text
from ._network_layout import network_layout as network_layout
from ._placed import all_values as all_values
from ._placed import placed_names as placed_names
from ._sensors import SHUTTER_SECONDS as SHUTTER_SECONDS
from ._sensors import Recalibrations as Recalibrations
from ._sensors import sensor_name as sensor_name
from ._system import conductance_entries as conductance_entries
from ._twin import check_twin as check_twin
from ._wiring import MAX_ELEMENTS as MAX_ELEMENTS
from ._wiring import Wiring as Wiring
from ._wiring import wiring_of as wiring_of
