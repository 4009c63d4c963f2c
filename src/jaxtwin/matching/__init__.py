"""Behavioural matching: parameters from recordings, step 4 of the paper."""

from ._band import Band, prediction_band
from ._fit import Fit, FittedParameter, Iteration, Optimum
from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState
from ._many import match_many
from ._match import match
from ._profile import Profile, profile

__all__ = [
    "Band",
    "BoundedLevenbergMarquardt",
    "Fit",
    "FittedParameter",
    "Iteration",
    "LMState",
    "Optimum",
    "Profile",
    "match",
    "match_many",
    "prediction_band",
    "profile",
]
