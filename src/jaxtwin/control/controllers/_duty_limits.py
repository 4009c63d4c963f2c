"""The limits of the duty that a controller commands: those of its constructor, or of its rig."""

import copy
from collections.abc import Sequence
from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from ...errors import ControlError
from ...rig import Rig
from ._controller import AbstractChannelGroupController, DutyLimits

# The lowest and the highest duty, each a number, or one for each cell and heater.
GivenLimits: TypeAlias = Sequence[float | int | Sequence[float | int]]


class AbstractDutyLimitedController(AbstractChannelGroupController):
    """A controller whose limits follow from its rig where its constructor gets none.

    Heaters cannot cool. A controller that does not know this waits for them: its integral winds up,
    and its plan is not what the rig does.
    """

    has_own_limits: eqx.AbstractVar[bool]
    """Whether the limits hold on every rig."""

    def for_rig(self, rig: Rig) -> "AbstractDutyLimitedController":
        """Returns the controller with limits of each cell and heater: by default -1 to 1 of a cell
        and 0 to 1 of a heater. Those of the constructor are cut off at 0 for the heaters of a rig
        that has cells too.

        **Raises:** `ControlError` for limits of another number of cells and heaters, or limits that
        leave a heater no duty.
        """
        if self.has_own_limits and not rig.cells:
            limits = limits_of_each(type(self).__name__, self.limits, rig)
        else:
            limits = limits_of_rig(type(self).__name__, self.limits, rig)
        limited = copy.copy(self)
        # The fields are no leaves, and no design depends on them.
        object.__setattr__(limited, "limits", limits)
        object.__setattr__(limited, "has_own_limits", True)
        return limited

    def duty_bounds(self, dtype: DTypeLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """The lowest and the highest duty as arrays: single numbers, or one for each cell."""
        lowest, highest = bounds_of(self.limits)
        return jnp.asarray(lowest, dtype), jnp.asarray(highest, dtype)

    def limited(self, duty: Float[Array, "..."]) -> Float[Array, "..."]:
        """The duty within the limits."""
        return jnp.clip(duty, *self.duty_bounds(duty.dtype))


def bounds_of(
    limits: DutyLimits,
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """The lowest and the highest duty as arrays, which a duty is compared with."""
    lowest, highest = limits
    return np.asarray(lowest, float), np.asarray(highest, float)


def limits_of_rig(where: str, limits: DutyLimits, rig: Rig) -> DutyLimits:
    """Limits of each cell and heater of a rig, with none below 0 for a heater.

    **Raises:** `ControlError` for limits of another number of cells and heaters, or limits that
    leave a heater no duty.
    """
    lowest, highest = bounds_of(limits_of_each(where, limits, rig))
    raised = np.maximum(lowest, rig.lowest_duty)
    bad = np.flatnonzero(raised >= np.broadcast_to(highest, raised.shape))
    if bad.size:
        raise ControlError(
            f"{where}: limits: expected a highest duty above 0 for the heater "
            f"{rig.driven[bad[0]]} of {rig.name}, which cannot cool, got "
            f"{np.broadcast_to(highest, raised.shape)[bad[0]]:g}"
        )
    return _as_limits(raised, highest)


def limits_of_each(where: str, limits: DutyLimits, rig: Rig) -> DutyLimits:
    """The same limits, as single numbers where those of all cells and heaters are equal.

    **Raises:** `ControlError` for limits of another number of cells and heaters.
    """
    bounds = bounds_of(limits)
    for bound in bounds:
        if bound.shape not in ((), (len(rig.driven),)):
            raise ControlError(
                f"{where}: limits: expected numbers, or one for each of {', '.join(rig.driven)} "
                f"of {rig.name}, got {bound.size}"
            )
    return _as_limits(*bounds)


def _as_limits(lowest: Float[np.ndarray, "..."], highest: Float[np.ndarray, "..."]) -> DutyLimits:
    return _bound(lowest), _bound(highest)


def _bound(bound: Float[np.ndarray, "..."]) -> float | tuple[float, ...]:
    values = np.unique(bound)
    return float(values[0]) if values.size == 1 else tuple(bound.tolist())


def checked_limits(where: str, limits: GivenLimits | None) -> DutyLimits:
    """Returns the lowest and the highest duty; for None those of cells, -1 and 1.

    **Raises:** `ControlError` if they are not within -1 to 1, or not in this order.
    """
    if limits is None:
        return -1.0, 1.0
    try:
        lowest, highest = (np.asarray(bound, float) for bound in limits)
        is_flat = max(lowest.ndim, highest.ndim) <= 1
        if not (is_flat and np.all((lowest >= -1) & (lowest < highest) & (highest <= 1))):
            raise ValueError
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: limits: expected the lowest and the highest duty, from -1 to 1, each a "
            f"number or one for each cell and heater, got {limits!r}"
        ) from None
    return _as_limits(lowest, highest)


def limits_text(limits: DutyLimits, rig: Rig) -> str:
    """The limits in words: `0 to 1`, or `-1 to 1 (P1), 0 to 1 (foil, bulb)`."""
    low, high = (np.broadcast_to(bound, (len(rig.driven),)) for bound in bounds_of(limits))
    named: dict[str, list[str]] = {}
    for name, lowest, highest in zip(rig.driven, low, high, strict=True):
        named.setdefault(f"{lowest:g} to {highest:g}", []).append(name)
    if len(named) == 1:
        return next(iter(named))
    return ", ".join(f"{text} ({', '.join(names)})" for text, names in named.items())


def check_limits_of_heaters(where: str, limits: DutyLimits, rig: Rig) -> None:
    """Refuses limits below 0 for heaters: the controller would wait for them to cool.

    **Raises:** `ControlError`.
    """
    lowest = np.broadcast_to(bounds_of(limits)[0], (len(rig.driven),))
    if rig.heaters and np.any(lowest < rig.lowest_duty):
        raise ControlError(
            f"{where}: expected limits from 0 on, because the heaters of {rig.name} cannot cool, "
            f"got {limits_text(limits, rig)}; leave the limits out, or give the controller "
            "limits=(0, 1)"
        )
