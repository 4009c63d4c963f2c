"""Behavioural matching: parameters from recordings, step 4 of the paper."""

from ._band import Band, prediction_band
from ._fit import (
    CameraError,
    Comparison,
    Fit,
    FittedParameter,
    FittedParameters,
    Iteration,
    Optimum,
)
from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState
from ._many import match_many
from ._match import checked_recordings, match
from ._noise import Noise, noise_of
from ._profile import Profile, profile
from ._settle import WARM_UP, settle

__all__ = [
    "WARM_UP",
    "Band",
    "BoundedLevenbergMarquardt",
    "CameraError",
    "Comparison",
    "Fit",
    "FittedParameter",
    "FittedParameters",
    "Iteration",
    "LMState",
    "Noise",
    "Optimum",
    "Profile",
    "checked_recordings",
    "match",
    "match_many",
    "noise_of",
    "prediction_band",
    "profile",
    "settle",
]
