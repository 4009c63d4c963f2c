"""Validation: how well a matched twin predicts recordings that the match has not seen."""

from ._validate import leave_one_out, validate, validate_split
from ._validation import Prediction, Validation
from ._whiteness import Whiteness, whiteness, whiteness_of_channels

__all__ = [
    "Prediction",
    "Validation",
    "Whiteness",
    "leave_one_out",
    "validate",
    "validate_split",
    "whiteness",
    "whiteness_of_channels",
]
