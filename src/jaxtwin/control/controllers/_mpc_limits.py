"""The arguments of an `MPC`, checked: limits of the rate and of temperatures, horizons, and points
that are to be even."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number, mapping_of, whole_number
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ._condensed_program import EvenPoints
from ._controller import TemperatureLimit
from ._evenness import EVENNESS_COSTS, AbstractEvennessCost
from ._plant import DesignPlant

# A point that the first move changes by less than this part of its change at rest within the
# horizon is not reached by it.
MIN_RESPONSE = 1e-6


def checked_temperature_limits(
    limits: Any,
    channels: Sequence[str] | None,
    accepted_excess: float,
    controller: str = "MPC",
) -> tuple[tuple[str, TemperatureLimit], ...]:
    """Returns the temperature limits with numbers as floats. The channels that they may name are
    those of the model; None if it names none. Limits that state no accepted excess get the given
    one, K.

    **Raises:** `ControlError` if they are not a mapping from channels to (lowest, highest), or to
    these with an accepted excess above 0.
    """
    where = f"{controller}: temperature_limits"
    if limits is None:
        return ()
    mapping_of(where, limits, "name -> (lowest, highest)", ControlError)
    result = []
    for name, pair in limits.items():
        if channels is not None and name not in channels:
            raise ControlError(f"{where}: {unknown_name('channel', name, channels)}")
        try:
            lowest, highest, *own = (float(number) for number in pair)
            (excess,) = own or (accepted_excess,)
            if not (-np.inf < lowest < highest < np.inf and 0 < excess < np.inf):
                raise ValueError
        except (TypeError, ValueError):
            raise ControlError(
                f"{where}: {name}: expected the lowest and the highest temperature, degC, and, if "
                f"it is not excess_deviation, an accepted excess above 0, K, got {pair!r}"
            ) from None
        result.append((name, TemperatureLimit(lowest, highest, float(excess))))
    return tuple(result)


def accepted_excesses(
    limits: Sequence[tuple[str, TemperatureLimit]], of_points: float
) -> Float[np.ndarray, " limited_and_points"]:
    """Returns the accepted excess of each channel with limits, and then that of points, K."""
    return np.array([*(limit.accepted_excess for _, limit in limits), of_points])


def checked_rate(rate_limit: float | int, controller: str = "MPC") -> float:
    """Returns the limit of the rate of the duty, 1/s.

    **Raises:** `ControlError` if it is not a number above 0.
    """
    number = finite_number(f"{controller}: rate_limit", rate_limit, ControlError)
    if number <= 0:
        raise ControlError(
            f"{controller}: rate_limit: expected a number above 0, 1/s, got {number:g}"
        )
    return number


def checked_control_horizon(control_horizon: Any, horizon: int, controller: str = "MPC") -> int:
    """Returns the number of samples in which the planned duty changes.

    **Raises:** `ControlError` if it is not a whole number from 1 to the horizon.
    """
    if control_horizon is None:
        return horizon
    number = whole_number(f"{controller}: control_horizon", control_horizon, 1, ControlError)
    if number > horizon:
        raise ControlError(
            f"{controller}: control_horizon: expected at most the horizon, {horizon}, got {number}"
        )
    return number


def checked_evenness(evenness: Any, points: Sequence[str]) -> AbstractEvennessCost | None:
    """Returns the cost of uneven points.

    **Raises:** `ControlError` if it is not one of the known convex costs, or comes without points,
    or there are points without it.
    """
    known = tuple(EVENNESS_COSTS.values())
    if evenness is not None and not isinstance(evenness, known):
        names = ", ".join(cost.__name__ for cost in known)
        raise ControlError(
            f"MPC: evenness: expected one of the convex costs {names}, got {evenness!r}"
        )
    if (evenness is None) != (len(points) == 0):
        raise ControlError(
            "MPC: points: expected names of outputs of the model together with evenness, got "
            f"points {list(points)!r} and evenness {evenness!r}"
        )
    return evenness


def channels_of(measured: Sequence[Sequence[str]] | None, model: Any) -> tuple[str, ...]:
    """Returns the channels of all outputs; those of the rig of the model for None."""
    if measured is not None:
        return tuple(name for group in measured for name in group)
    if isinstance(model, DesignPlant):
        raise ControlError("MPC: measured: expected the channels of the outputs with evenness")
    return tuple(model.output_names)


def checked_point_errors(
    shares: Any, points: Sequence[str], channels: Sequence[str]
) -> Float[np.ndarray, "points channels"]:
    """Returns what an error of 1 K of each read channel changes at each point; None for the channel
    itself alone.

    **Raises:** `ControlError` for another shape, or numbers that are not finite.
    """
    if shares is None:
        return np.array([[float(point == channel) for channel in channels] for point in points])
    result = np.asarray(shares, float)
    if result.shape != (len(points), len(channels)) or not np.isfinite(result).all():
        raise ControlError(
            f"MPC: point_errors: expected finite numbers of {len(points)} points by "
            f"{len(channels)} channels, got shape {result.shape}"
        )
    return result


def check_horizon(points: EvenPoints, horizon: int, sample_time_s: float) -> None:
    """Refuses a horizon in which no move reaches a point, because the delay is longer.

    **Raises:** `ControlError`.
    """
    cells = np.shape(points.rest_gain)[1]
    last = np.asarray(points.by_moves)[-len(points.at) :, :cells]
    if not np.abs(last).max() > MIN_RESPONSE * np.abs(points.rest_gain).max():
        raise ControlError(
            f"MPC: horizon: expected more samples than the delay of the model takes, got {horizon} "
            f"of {sample_time_s:g} s"
        )
