# The public names of jaxtwin.simulation. `__init__.py` reads this file at run time and imports a
# name when it is first used: the default solver does without diffrax.

from ._chunk_programs import Precision as Precision
from ._drive import Drive as Drive
from ._grid_convergence import Grid as Grid
from ._grid_convergence import GridConvergence as GridConvergence
from ._grid_convergence import grid_convergence as grid_convergence
from ._integrate import solve_network as solve_network
from ._network_exponential import HeldInputs as HeldInputs
from ._network_exponential import NetworkExponential as NetworkExponential
from ._network_exponential import NetworkProblem as NetworkProblem
from ._network_exponential import network_field as network_field
from ._reduced_stepper import reduce_stepper as reduce_stepper
from ._reductions import REDUCTIONS as REDUCTIONS
from ._reductions import ReductionName as ReductionName
from ._reductions import Reductions as Reductions
from ._rodas5p import Rodas5P as Rodas5P
from ._run import Run as Run
from ._run import Uniformity as Uniformity
from ._run import fit_percent as fit_percent
from ._run import rmse as rmse
from ._run import uniformity as uniformity
from ._simulate import response as response
from ._simulate import simulate as simulate
from ._simulate_batch import BatchTemperatures as BatchTemperatures
from ._simulate_batch import reduce_batch as reduce_batch
from ._simulate_batch import simulate_batch as simulate_batch
from ._stepper import Stepper as Stepper
from ._stepper import StepperState as StepperState
from ._time_grid import TimeGrid as TimeGrid
from ._time_grid import build_time_grid as build_time_grid
from ._time_grid import time_grid as time_grid
