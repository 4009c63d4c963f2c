"""Bounds of a controller's parameters, scaled to the unit box in which a search runs."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..._arguments import names_of
from ...errors import ControlError
from ..controllers._controller import AbstractController
from ..controllers._controller_vector import ControllerVector, split
from ..controllers._decoupled_pi import DecoupledPI
from ..controllers._design_vector import DesignVector
from ..controllers._lqi import LQI
from ..controllers._mpc import MPC
from ..controllers._pid import PID

# The factor by which a parameter without bounds may grow or fall.
DEFAULT_FACTOR = 30.0


class SearchBox(NamedTuple):
    """The map between parameters with bounds and the unit box. Parameters whose bounds are above 0
    are scaled by their logarithm."""

    lower: Float[np.ndarray, " parameters"]
    upper: Float[np.ndarray, " parameters"]

    @property
    def is_logarithmic(self) -> Bool[np.ndarray, " parameters"]:
        return self.lower > 0

    def values(self, point: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the parameters at a point of the unit box, within their bounds."""
        lower, upper = self._ends()
        result = lower + point * (upper - lower)
        result = np.where(
            self.is_logarithmic, np.exp(np.where(self.is_logarithmic, result, 0)), result
        )
        return np.clip(result, self.lower, self.upper)

    def point(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the point of parameters, which are clipped to their bounds."""
        lower, upper = self._ends()
        inside = np.clip(values, self.lower, self.upper)
        result = np.where(self.is_logarithmic, np.log(np.where(inside > 0, inside, 1)), inside)
        return np.clip((result - lower) / (upper - lower), 0, 1)

    def slopes(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Returns the derivatives of the parameters with respect to the point."""
        lower, upper = self._ends()
        return (upper - lower) * np.where(self.is_logarithmic, values, 1.0)

    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        is_logarithmic = self.is_logarithmic
        lower, upper = (
            np.where(is_logarithmic, np.log(np.where(is_logarithmic, end, 1.0)), end)
            for end in (self.lower, self.upper)
        )
        return lower, upper


def search_box(
    where: str,
    controller: Any,
    tuned: Iterable[str] | Mapping[str, tuple[float, float]] | None,
) -> tuple[ControllerVector | DesignVector, SearchBox]:
    """Checks the arguments of `tune` that concern parameters, and makes the search box.

    **Raises:** `ControlError` for unknown names, for invalid bounds, and for a parameter that needs
    bounds and has none.
    """
    if tuned is None:
        tuned = _usual(where, controller)
    bounds = dict(tuned) if isinstance(tuned, Mapping) else {}
    names = tuple(bounds) if bounds else names_of(where, tuned, ControlError)
    if any(name in controller.design_weights() for name in names):
        vector = DesignVector(where, controller, names)
    else:
        vector = ControllerVector.of(where, controller, names)
    lower, upper = [], []
    given = split(vector.values, [shape for _, shape in vector.shapes])
    for (name, _), part in zip(vector.shapes, given, strict=True):
        value = np.ravel(part)
        low, high = (
            _pair(f"{where}: {name}", bounds[name])
            if name in bounds
            else _about(where, name, value)
        )
        lower.append(np.broadcast_to(low, value.shape))
        upper.append(np.broadcast_to(high, value.shape))
    return vector, SearchBox(np.concatenate(lower), np.concatenate(upper))


def _usual(where: str, controller: AbstractController) -> tuple[str, ...]:
    names = {
        PID: ("Kp", "Ki", "Kd"),
        DecoupledPI: ("Kp_mean", "Ki_mean", "Kp_difference", "Ki_difference"),
        LQI: ("integral_deviation", "duty_deviation", "reading_noise"),
        MPC: ("duty_deviation", "duty_change_deviation", "reading_noise"),
    }.get(type(controller))
    if names is not None and (isinstance(controller, LQI | MPC)):
        if controller.design_weights():
            return names
        names = None
    if names is None:
        raise ControlError(
            f"{where}: expected names of parameters for a {type(controller).__name__}, or name -> "
            "(lowest, highest), got None"
        )
    used = tuple(name for name in names if np.any(np.asarray(getattr(controller, name)) > 0))
    if not used:
        raise ControlError(f"{where}: expected a controller with gains above 0, got {controller}")
    return used


def _pair(where: str, bounds: Any) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in bounds)
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: expected (lowest, highest), finite numbers in this order, got {bounds!r}"
        ) from None
    return low, high


def _about(where: str, name: str, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not np.all(value > 0):
        raise ControlError(
            f"{where}: {name}: expected bounds, because its value is not above 0, got none; pass "
            f"tuned={{{name!r}: (lowest, highest)}}"
        )
    return value / DEFAULT_FACTOR, value * DEFAULT_FACTOR
