"""Behavioural matching: parameters from recordings, step 4 of the paper."""

from ._fit import Fit, FittedParameter, Iteration, Optimum
from ._levenberg_marquardt import BoundedLevenbergMarquardt, LMState
from ._match import match

__all__ = [
    "BoundedLevenbergMarquardt",
    "Fit",
    "FittedParameter",
    "Iteration",
    "LMState",
    "Optimum",
    "match",
]
