# Public names of jaxtwin.control. `__init__.py` imports each when it is first used.

from .controllers._controller import AbstractController as AbstractController
from .controllers._controller import Law as Law  # the law of a controller in C
from .controllers._controller import TemperatureLimit as TemperatureLimit  # of a channel
from .controllers._controller_fields import (
    ControllerField as ControllerField,  # a number with its unit
)
from .controllers._controller_file import (
    ControllerDesign as ControllerDesign,  # for what a controller was designed
)
from .controllers._controller_file import read_controller as read_controller  # .toml -> controller
from .controllers._controller_file import read_design as read_design  # of a file
from .controllers._controller_file import (
    register_controller as register_controller,  # a class with files
)
from .controllers._controller_file import save_controller as save_controller
from .controllers._decoupled_pi import DecoupledPI as DecoupledPI  # on the mean and on differences
from .controllers._decoupled_pi import decoupling_of as decoupling_of  # from the plate's gain
from .controllers._function_controller import FunctionController as FunctionController
from .controllers._gain_scheduled import GainScheduled as GainScheduled  # over operating points
from .controllers._kalman import KalmanFilter as KalmanFilter  # with the disturbance
from .controllers._lqi import LQI as LQI  # state feedback with integral action
from .controllers._lqi import design_lqi as design_lqi  # linear model -> LQI
from .controllers._mpc import MPC as MPC  # hard limits of duty and rate
from .controllers._mpc import design_mpc as design_mpc  # linear model -> MPC
from .controllers._mpc_programs import AbstractEvennessCost as AbstractEvennessCost
from .controllers._mpc_programs import RangeCost as RangeCost  # hottest less coldest
from .controllers._mpc_programs import SquaresCost as SquaresCost  # of all deviations
from .controllers._mpc_programs import WorstPointCost as WorstPointCost  # minimax
from .controllers._nonlinear_mpc import NonlinearMPC as NonlinearMPC  # the twin is its model
from .controllers._nonlinear_mpc import (
    design_nonlinear_mpc as design_nonlinear_mpc,  # twin -> NonlinearMPC
)
from .controllers._pid import PID as PID
from .controllers._relay import Relay as Relay  # an oscillation at the critical frequency
from .controllers._time_proportional import (
    TimeProportional as TimeProportional,  # heaters that relays switch
)
from .controllers._uniformity_mpc import (
    design_uniformity_mpc as design_uniformity_mpc,  # an MPC of the most even plate
)
from .linear._frequency_response import Directions as Directions  # mean and uniformity
from .linear._linearize import linearize as linearize  # twin or fit -> StateSpace
from .linear._margins import DiskMargin as DiskMargin  # of gain and phase together
from .linear._margins import Margins as Margins  # gm, pm, wcg, wcp
from .linear._margins import disk_margin as disk_margin  # of a loop with one channel or several
from .linear._margins import margins as margins  # of a loop with a single channel
from .linear._margins import sensitivity_peak as sensitivity_peak  # by how much a loop makes worse
from .linear._operating_point import OperatingPoint as OperatingPoint  # a steady state
from .linear._state_space import StateSpace as StateSpace  # a linear model, continuous or discrete
from .loops._closed_loop import closed_loop as closed_loop  # a closed loop as a pure JAX function
from .loops._closed_loop_run import ClosedLoopRun as ClosedLoopRun  # the result, with labels
from .loops._control import Decision as Decision  # a sample of a controller on a live rig
from .loops._control import LiveLoop as LiveLoop
from .loops._control import control as control  # a controller on a live rig
from .loops._control import simulate_closed_loop as simulate_closed_loop
from .loops._disturbances import Draught as Draught  # air upon the plate
from .loops._disturbances import HeatInput as HeatInput  # a hand upon the plate
from .loops._loop_margins import LoopMargins as LoopMargins  # how far a loop is from instability
from .loops._loop_margins import loop_margins as loop_margins  # of a controller on a twin
from .loops._measures import MEASURES as MEASURES  # name -> function of a ClosedLoop, unit
from .loops._measures import ClosedLoop as ClosedLoop  # what happened in a closed loop
from .loops._scenario import Scenario as Scenario  # what a closed loop goes through
from .loops._scenario import scenario as scenario
from .loops._simulate_closed_loops import simulate_closed_loops as simulate_closed_loops
from .loops._soft_limits import ExceededLimit as ExceededLimit  # that no duty kept
from .tuning._design_rig import design_rig as design_rig  # places of cells for the most even plate
from .tuning._frontier import Frontier as Frontier  # the trade between two aims
from .tuning._frontier import frontier as frontier  # controllers tuned by several weights
from .tuning._most_even_point import most_even_point as most_even_point  # the least range at rest
from .tuning._rig_design import PlacedCells as PlacedCells
from .tuning._rig_design import RigDesign as RigDesign  # the result
from .tuning._tune import tune as tune  # gains by the derivatives of the closed loop
from .tuning._tuning import TunedLoop as TunedLoop  # a controller and what its loops do
from .tuning._tuning import Tuning as Tuning  # the result
from .tuning._tuning import TuningStep as TuningStep  # a controller that the search looked at
from .tuning._ultimate_point import UltimatePoint as UltimatePoint  # ultimate gain and period
from .tuning._ultimate_point import ultimate_point as ultimate_point  # from a run with a Relay

__all__: list[str]

# isort: split
# For the other packages of jaxtwin: no part of the public interface.

from .controllers._controller import LawTable as LawTable
from .controllers._controller import is_same as is_same
from .controllers._controller import is_same_kind as is_same_kind
from .controllers._controller_file import controller_file as controller_file
from .controllers._controller_file import controller_of_text as controller_of_text
from .controllers._duty_limits import bounds_of as bounds_of
from .controllers._duty_limits import check_limits_of_heaters as check_limits_of_heaters
from .controllers._duty_limits import limits_text as limits_text
from .linear._margins import USUAL_PEAK as USUAL_PEAK
from .linear._state_space import checked_discrete_model as checked_discrete_model
from .loops._disturbances import Disturbance as Disturbance
from .loops._loop_checks import OutOfReachError as OutOfReachError
from .loops._loop_margins import sampled_loops as sampled_loops
from .loops._measures import REST_FRACTION as REST_FRACTION
from .loops._measures import SETTLING_BAND as SETTLING_BAND
from .loops._measures import Measure as Measure
from .loops._references import reference_samples as reference_samples
from .loops._references import sample_times as sample_times
from .loops._sampled_loop import ROUNDING as ROUNDING
from .loops._sampled_loop import SampledLoops as SampledLoops
from .loops._scenario import MAX_STEP as MAX_STEP
from .loops._simulate_closed_loops import longest_delay as longest_delay
from .loops._simulate_closed_loops import simulate_many_loops as simulate_many_loops
from .loops._simulate_closed_loops import twin_at_medians as twin_at_medians
from .tuning._objective import TuningObjective as TuningObjective
from .tuning._objective import checked_objective as checked_objective
from .tuning._tuning_problem import PEAK_TOLERANCE as PEAK_TOLERANCE
from .tuning._tuning_problem import tuning_problem as tuning_problem
