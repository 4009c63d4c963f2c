"""Behavioural matching: parameters from recordings, step 4 of the paper."""

from ._band import Band, prediction_band
from ._difference import FitDifference, ParameterDifference, compare_fits
from ._fit import (
    CameraError,
    Comparison,
    Fit,
    FittedParameter,
    FittedParameters,
    Iteration,
    Optimum,
)
from ._initial_conditions import WARM_UP, InitialConditions, estimate_initial_conditions
from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState
from ._many import match_many
from ._match import checked_recordings, match
from ._noise import Noise, estimate_noise
from ._profile import Profile, profile

__all__ = [
    "WARM_UP",
    "Band",
    "BoundedLevenbergMarquardt",
    "CameraError",
    "Comparison",
    "Fit",
    "FitDifference",
    "FittedParameter",
    "FittedParameters",
    "InitialConditions",
    "Iteration",
    "LMState",
    "Noise",
    "Optimum",
    "ParameterDifference",
    "Profile",
    "checked_recordings",
    "compare_fits",
    "estimate_initial_conditions",
    "estimate_noise",
    "match",
    "match_many",
    "prediction_band",
    "profile",
]
