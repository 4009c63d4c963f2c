"""What controllers that plan over a horizon share: their limits of the rate and of temperatures,
and the references that they look ahead to."""

import copy
import math
from collections.abc import Mapping
from typing import TypeVar

import equinox as eqx

from ...errors import ControlError
from ...rig import Rig
from ._controller import TemperatureLimit
from ._duty_limits import AbstractDutyLimitedController
from ._plant import check_designed_for

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
