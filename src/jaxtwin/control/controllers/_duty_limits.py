"""The limits of the duty that a controller commands: those of its constructor, or of its rig."""

import copy
from collections.abc import Sequence

import equinox as eqx

from ..._errors import ControlError
from ...rig import Rig
from ._controller import AbstractChannelGroupController


class AbstractDutyLimitedController(AbstractChannelGroupController):
    """A controller whose limits follow from its rig where its constructor gets none.

    Heaters cannot cool. A controller that does not know this waits for them: its integral winds up,
    and its plan is not what the rig does.
    """

    has_own_limits: eqx.AbstractVar[bool]
    """Whether the limits hold on every rig."""

    def for_rig(self, rig: Rig) -> "AbstractDutyLimitedController":
        """Returns the controller with limits: -1 to 1, or 0 to 1 for a rig with heaters, unless
        the constructor got others."""
        if self.has_own_limits:
            return self
        lowest, highest = self.limits
        limited = copy.copy(self)
        # The fields are no leaves, and no design depends on them.
        object.__setattr__(limited, "limits", (max(lowest, *rig.lowest_duty), highest))
        object.__setattr__(limited, "has_own_limits", True)
        return limited


def checked_limits(where: str, limits: Sequence[float | int] | None) -> tuple[float, float]:
    """Returns the lowest and the highest duty; for None those of cells, -1 and 1.

    **Raises:** `ControlError` if they are not within -1 to 1, or not in this order.
    """
    if limits is None:
        return -1.0, 1.0
    try:
        lowest, highest = (float(limit) for limit in limits)
        if not -1 <= lowest < highest <= 1:
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: limits: expected the lowest and the highest duty, from -1 to 1, got "
            f"{limits!r}"
        ) from None
    return lowest, highest


def check_limits_of_heaters(where: str, limits: tuple[float, float], rig: Rig) -> None:
    """Refuses limits below 0 for a rig with heaters: the controller would wait for them to cool.

    **Raises:** `ControlError`.
    """
    if rig.heaters and limits[0] < 0:
        raise ControlError(
            f"{where}: expected limits from 0 on, because the heaters of {rig.name} cannot cool, "
            f"got {limits[0]:g} to {limits[1]:g}; leave the limits out, or give the controller "
            "limits=(0, 1)"
        )
