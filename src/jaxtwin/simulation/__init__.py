"""Simulation: one run or many draws.

The default solver is exponential time differencing in the modes of the thermal network on a time
grid that is fine after each input change; any diffrax solver can take its place.
"""

from .._measures import fit_percent, rmse
from ._ambient import ambient_of_samples, reference_temperature
from ._batch import (
    REDUCTIONS,
    Reductions,
    checked_precision,
    checked_reductions,
    simulate_batch,
)
from ._chunk import Reduction
from ._chunk_runner import Precision
from ._padding import padded, padded_schedule
from ._run import Run
from ._schedule import Schedule, build_schedule, twin_schedule
from ._simulate import checked_channels, response, simulate
from ._solve import solve_schedule
from ._solver import HeldInputs, NetworkExponential, NetworkProblem, network_field
from ._uniformity import Uniformity, uniformity

__all__ = [
    "REDUCTIONS",
    "HeldInputs",
    "NetworkExponential",
    "NetworkProblem",
    "Precision",
    "Reduction",
    "Reductions",
    "Run",
    "Schedule",
    "Uniformity",
    "ambient_of_samples",
    "build_schedule",
    "checked_channels",
    "checked_precision",
    "checked_reductions",
    "fit_percent",
    "network_field",
    "padded",
    "padded_schedule",
    "reference_temperature",
    "response",
    "rmse",
    "simulate",
    "simulate_batch",
    "solve_schedule",
    "twin_schedule",
    "uniformity",
]
