# The public names of jaxtwin.control; `__init__.py` reads this file at run time.

from ._closed_loop import closed_loop as closed_loop  # a closed loop as a pure JAX function
from ._closed_loop_run import ClosedLoopRun as ClosedLoopRun  # the result, with labels
from ._control import LiveLoop as LiveLoop
from ._control import control as control  # a controller on a live rig
from ._controller import AbstractController as AbstractController
from ._controller_fields import ControllerField as ControllerField  # a number with its unit
from ._controller_file import read_controller as read_controller  # .toml -> controller
from ._controller_file import register_controller as register_controller  # a class with files
from ._controller_file import save_controller as save_controller
from ._decision import Decision as Decision  # a sample of a controller on a live rig
from ._decoupled_pi import DecoupledPI as DecoupledPI  # on the mean and on differences
from ._decoupled_pi import decoupling_of as decoupling_of  # from the plate's gain
from ._directions import Directions as Directions  # mean and uniformity
from ._discrete_model import DiscreteModel as DiscreteModel  # a linear model step by step
from ._disturbances import Draught as Draught  # air upon the plate
from ._disturbances import HeatInput as HeatInput  # a hand upon the plate
from ._frontier import Frontier as Frontier  # the trade between two aims
from ._frontier import frontier as frontier  # controllers tuned by several weights
from ._function_controller import FunctionController as FunctionController
from ._kalman import KalmanFilter as KalmanFilter  # with the disturbance
from ._law import Law as Law  # the law of a controller in C
from ._linear_model import LinearModel as LinearModel  # a twin near an operating point
from ._linearize import linearize as linearize  # twin or fit -> LinearModel
from ._loop_signals import ClosedLoop as ClosedLoop  # what happened in a closed loop
from ._lqi import LQI as LQI  # state feedback with integral action
from ._margins import DiskMargin as DiskMargin  # of gain and phase together
from ._margins import Margins as Margins  # gm, pm, wcg, wcp
from ._margins import disk_margin as disk_margin  # of a loop with one channel or several
from ._margins import margins as margins  # of a loop with a single channel
from ._margins import sensitivity_peak as sensitivity_peak  # by how much a loop makes worse
from ._measures import MEASURES as MEASURES  # name -> function of a ClosedLoop, unit
from ._most_even_point import most_even_point as most_even_point  # the least range at rest
from ._mpc import MPC as MPC  # hard limits of duty and rate
from ._operating_point import OperatingPoint as OperatingPoint  # a steady state
from ._pid import PID as PID
from ._relay import Relay as Relay  # an oscillation at the critical frequency
from ._scenario import Scenario as Scenario  # what a closed loop goes through
from ._scenario import scenario as scenario
from ._simulate_closed_loop import simulate_closed_loop as simulate_closed_loop
from ._tune import tune as tune  # gains by the derivatives of the closed loop
from ._tuning import TunedLoop as TunedLoop  # a controller and what its loops do
from ._tuning import Tuning as Tuning  # the result
from ._tuning import TuningStep as TuningStep  # a controller that the search looked at
from ._ultimate_point import UltimatePoint as UltimatePoint  # ultimate gain and period
from ._ultimate_point import ultimate_point as ultimate_point  # from a run with a Relay

__all__: list[str]
