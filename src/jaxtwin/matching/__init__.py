"""Behavioural matching: parameters from recordings, step 4 of the paper."""

from ._fit import Fit, FittedParameter, Iteration, Optimum
from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState
from ._match import checked_recordings, match
from ._noise import Noise, noise_of
from ._settle import WARM_UP, settle

__all__ = [
    "WARM_UP",
    "BoundedLevenbergMarquardt",
    "Fit",
    "FittedParameter",
    "Iteration",
    "LMState",
    "Noise",
    "Optimum",
    "checked_recordings",
    "match",
    "noise_of",
    "settle",
]
