"""What controllers that plan over a horizon share: their limits of the rate and of temperatures,
the references that they look ahead to, and the checks of these arguments."""

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._arguments import finite_number, mapping_of, whole_number
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...rig import Rig
from ._controller import TemperatureLimit
from ._design_model import check_designed_for
from ._duty_limits import AbstractDutyLimitedController
from ._mpc_programs import EVENNESS_COSTS, AbstractEvennessCost, EvenPoints

Predictive = TypeVar("Predictive", bound="AbstractPredictiveController")


class AbstractPredictiveController(AbstractDutyLimitedController):
    """A controller that plans the duty of the next samples, within limits."""

    horizon: eqx.AbstractVar[int]
    """The number of samples that are planned."""
    preview: eqx.AbstractVar[bool]
    """Whether `step` gets the references of the whole horizon."""
    rate_limit: eqx.AbstractVar[float | None]
    """The largest rate of the duty, 1/s; None for any."""
    counts: eqx.AbstractVar[int | None]
    """Full duty in counts of the driver; None before the controller knows its rig."""
    temperature_limits: eqx.AbstractVar[tuple[tuple[str, TemperatureLimit], ...]]
    """The limits of channels, by name."""
    designed_for: eqx.AbstractVar[str]
    """The rig of the model; empty for that of no rig file."""

    def for_rig(self: Predictive, rig: Rig) -> Predictive:
        """Returns the controller with the limits of a rig, and the counts of its driver.

        **Raises:** `ControlError` for another rig than that of the model, or a rate limit of less
        than a count in a sample.
        """
        name = type(self).__name__
        check_designed_for(name, self.designed_for, rig)
        limited = copy.copy(super().for_rig(rig))
        assert isinstance(limited, type(self))
        # The field is no leaf, and no design depends on it.
        object.__setattr__(limited, "counts", rig.driver.counts)
        if limited.reach == 0:
            least = 1 / (rig.driver.counts * self.sample_time_s)
            raise ControlError(
                f"{name}: rate_limit: expected at least a count of the driver in a sample, "
                f"{least:.3g} 1/s, got {self.rate_limit:g} 1/s"
            )
        return limited

    @property
    def preview_samples(self) -> int:
        """The horizon, with `preview`."""
        return self.horizon if self.preview else 0

    def channel_limits(self) -> Mapping[str, TemperatureLimit]:
        """Returns the temperature limits."""
        return dict(self.temperature_limits)

    @property
    def reach(self) -> float | None:
        """The largest change of the duty in a sample, in whole counts of the driver if they are
        known; None for any."""
        if self.rate_limit is None:
            return None
        reach = self.rate_limit * self.sample_time_s
        if self.counts is None:
            return reach
        return math.floor(reach * self.counts * (1 + 1e-9)) / self.counts


# The accepted excess over a temperature limit that states none, K.
DEFAULT_EXCESS = 0.1


# The arguments of an `MPC`, checked: limits of the rate and of temperatures, horizons, and points
# that are to be even.

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
    where = f"{controller}: rate_limit"
    return finite_number(where, rate_limit, ControlError, above=0, unit="1/s")


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
