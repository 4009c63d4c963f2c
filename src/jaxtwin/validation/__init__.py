"""Validation: how well a matched twin predicts recordings that the match has not seen.

`_validate` predicts another recording, the rest of one, or a group that was left out, and returns a
`Validation` (`_validation`), which tests whether what is left is only noise.
"""

from ._validate import leave_one_out, validate, validate_split
from ._validation import Prediction, Validation, Whiteness, whiteness, whiteness_of_channels

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
