"""Values for JSON, which has no NaN, no infinity and no arrays."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def json_value(value: Any) -> Any:
    """A value for JSON, with everything in it: None for a number that is not finite, lists for
    arrays and tuples, Python's numbers for those of NumPy. Other values stay as they are."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: json_value(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [json_value(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
