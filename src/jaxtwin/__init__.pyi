# The public names of jaxtwin, one line each, in the order of the five steps. `__init__.py` reads
# this file at run time and imports a name when it is first used; type checkers and editors read it
# as it stands. Errors are in `jaxtwin.errors`, the types of results in their packages.

# isort: skip_file

# 1. Define and document: a rig, and what was recorded of it
from .rig import Rig as Rig  # a rig file, read and checked
from .rig import bundled_rigs as bundled_rigs  # names of the bundled rigs
from .rig import load_rig as load_rig  # a bundled rig, or a .toml file of yours
from .rig import read_parameters as read_parameters  # values that a fit saved
from .io import Experiment as Experiment  # inputs and recorded outputs of one run
from .io import read_recording as read_recording  # .mat, .csv or .nc -> Experiment
from .io import write_recording as write_recording  # Experiment -> .csv or .nc
from .io import find_recordings as find_recordings  # where they are on this machine
from .io import fetch_recordings as fetch_recordings  # the authors' recordings, by checksum

# 2. Simulate
from .physics import Twin as Twin  # a rig with values for its parameters
from .simulation import simulate as simulate  # one run
from .simulation import simulate_batch as simulate_batch  # many draws
from .simulation import reduce_batch as reduce_batch  # numbers of many draws
from .simulation import response as response  # the same as a pure JAX function
from .simulation import Stepper as Stepper  # a twin step by step
from .simulation import grid_convergence as grid_convergence  # the grid by the accuracy wanted
from .sweeps import sweep as sweep  # millions of draws written to a folder
from .sweeps import open_sweep as open_sweep  # its results, as an xarray data set

# 3. Match, and validate
from .identification import identify as identify  # a twin from a log, without a rig file
from .matching import match as match  # parameters from recordings
from .matching import match_many as match_many  # the same for many sets of recordings at once
from .matching import Fit as Fit  # the result of a match
from .matching import compare_fits as compare_fits  # the differences in standard errors
from .matching import profile as profile  # the cost of a match over one parameter
from .matching import prediction_band as prediction_band  # where readings are expected
from .validation import validate as validate  # recordings that the match has not seen
from .validation import validate_split as validate_split  # the rest from a match to the first part
from .validation import leave_one_out as leave_one_out  # each recording from a match to the others

# 4. Analyse: what matters, and what to record next
from .sensitivity_analysis import sensitivity as sensitivity  # which parameters matter
from .sensitivity_analysis import global_sensitivity as global_sensitivity  # for any outputs
from .experiment_design import design_experiment as design_experiment  # and how to find it

# 5. Deploy: the twin beside its rig, and control
from .observers import ProcessNoise as ProcessNoise  # what a twin does not know of its rig
from .observers import estimate_noise as estimate_noise  # and how to find it
from .observers import observe as observe  # what a rig is doing, from its readings
from .monitoring import calibrate_monitor as calibrate_monitor  # what is healthy
from .monitoring import monitor as monitor  # what has changed in a rig, and since when
from .diagnosis import diagnose as diagnose  # which fault, since when, how large
from .diagnosis import isolability as isolability  # and what it could say, before the fact
from .prognostics import health as health  # trends, and when limits are passed
from .refitting import refit as refit  # a twin from new recordings, through a gate
from .retuning import retune as retune  # a controller on a new twin, tried before it is used
from .twin_store import TwinStore as TwinStore  # a memory of twins: versions and aliases
from .control import linearize as linearize  # twin or fit -> StateSpace, by exact derivatives
from .control import simulate_closed_loop as simulate_closed_loop  # a controller on a twin
from .control import simulate_closed_loops as simulate_closed_loops  # for many draws
from .control import tune as tune  # a controller's gains, through the closed loop
from .control import design_rig as design_rig  # and how to find it
from .c_export import export_c as export_c  # a model, a twin or a controller as C
from .fmu import export_fmu as export_fmu  # a twin as an FMU, for other simulators

from .errors import JaxtwinError as JaxtwinError  # the base class of all errors

__all__: list[str]
__version__: str
