"""Behavioural matching: parameters from recordings, step 4 of the paper.

The way from a recording to a fit: `_problem` checks it, `_noise_model` says how its samples count,
`_objective` stacks it, `_residuals` and `_jacobian` solve the twin and subtract, `_descent`
minimises, `_reweighted_least_squares` repeats, `_make_fit` puts the `Fit` together.
"""

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
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._many import match_many
from ._match import match
from ._noise import Noise, estimate_noise
from ._problem import named_recordings
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
    "Noise",
    "Optimum",
    "ParameterDifference",
    "Profile",
    "compare_fits",
    "estimate_initial_conditions",
    "estimate_noise",
    "match",
    "match_many",
    "named_recordings",
    "prediction_band",
    "profile",
]
