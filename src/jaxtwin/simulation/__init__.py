"""Simulation: one run or many draws.

The default solver is exponential time differencing in the modes of the thermal network on a time
grid that is fine after each input change; any diffrax solver can take its place.
"""

from .._measures import fit_percent, rmse
from ._draws import Precision
from ._drive import Drive
from ._integrate import solve_network
from ._network_exponential import HeldInputs, NetworkExponential, NetworkProblem, network_field
from ._padding import padded, padded_time_grid
from ._reductions import REDUCTIONS, ReductionName, Reductions, checked_reductions
from ._run import Run
from ._simulate import checked_channels, response, simulate
from ._simulate_batch import checked_precision, simulate_batch
from ._stepper import Stepper, StepperState
from ._time_grid import TimeGrid, build_time_grid, time_grid
from ._uniformity import Uniformity, uniformity

__all__ = [
    "REDUCTIONS",
    "Drive",
    "HeldInputs",
    "NetworkExponential",
    "NetworkProblem",
    "Precision",
    "ReductionName",
    "Reductions",
    "Run",
    "Stepper",
    "StepperState",
    "TimeGrid",
    "Uniformity",
    "build_time_grid",
    "checked_channels",
    "checked_precision",
    "checked_reductions",
    "fit_percent",
    "network_field",
    "padded",
    "padded_time_grid",
    "response",
    "rmse",
    "simulate",
    "simulate_batch",
    "solve_network",
    "time_grid",
    "uniformity",
]
