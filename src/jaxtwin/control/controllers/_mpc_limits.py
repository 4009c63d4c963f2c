"""The limits of an `MPC`, checked: the rate of the duty, and temperatures of channels."""

from typing import Any

import numpy as np

from ..._arguments import finite_number, mapping_of
from ..._errors import ControlError
from ..._name_suggestions import unknown_name
from ..linear._discrete_model import DiscreteModel


def checked_temperature_limits(limits: Any, model: Any) -> tuple[tuple[str, float, float], ...]:
    """Returns the temperature limits with numbers as floats.

    **Raises:** `ControlError` if they are not a mapping from channels to (lowest, highest).
    """
    where = "MPC: temperature_limits"
    if limits is None:
        return ()
    mapping_of(where, limits, "name -> (lowest, highest)", ControlError)
    found = []
    for name, pair in limits.items():
        known = model.output_names if isinstance(model, DiscreteModel) else tuple(limits)
        if name not in known:
            raise ControlError(f"{where}: {unknown_name('channel', name, known)}")
        try:
            lowest, highest = (float(limit) for limit in pair)
            if not -np.inf < lowest < highest < np.inf:
                raise ValueError
        except (TypeError, ValueError):
            raise ControlError(
                f"{where}: {name}: expected the lowest and the highest temperature, degC, got "
                f"{pair!r}"
            ) from None
        found.append((name, lowest, highest))
    return tuple(found)


def checked_rate(rate_limit: float | int) -> float:
    """Returns the limit of the rate of the duty, 1/s.

    **Raises:** `ControlError` if it is not a number above 0.
    """
    number = finite_number("MPC: rate_limit", rate_limit, ControlError)
    if number <= 0:
        raise ControlError(f"MPC: rate_limit: expected a number above 0, 1/s, got {number:g}")
    return number
