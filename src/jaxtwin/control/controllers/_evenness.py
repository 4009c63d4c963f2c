r"""What makes temperatures uneven, as the cost of a model predictive controller.

The outputs of an `MPC` keep their references. If there are more cells than outputs, many duty
cycles do so at rest. The controller takes the one of the least cost $J(y)$, a convex function of
the temperatures $y$ of many points, and then plans such that no point is farther off on the way
than the farthest one will be at rest.
"""

from collections.abc import Mapping
from typing import ClassVar, final

import equinox as eqx

from ..._arguments import finite_number
from ...errors import ControlError


class AbstractEvennessCost(eqx.Module):
    """A convex cost of the temperatures of many points, K.

    With an `energy_price` a duty at rest costs what it draws, too: points that are less even by
    that many K are accepted if the sum of the duty cycles becomes smaller by 1.
    """

    name: ClassVar[str]
    """The name of the cost in controller files."""

    is_quadratic: ClassVar[bool] = False
    """Whether it is a sum of squares, and not the deviation of the points that are farthest off."""

    has_free_centre: ClassVar[bool] = False
    """Whether deviations are counted from a temperature that is free, and not from the
    reference."""

    energy_price: eqx.AbstractVar[float]

    def __check_init__(self) -> None:
        where = f"{type(self).__name__}: energy_price"
        if finite_number(where, self.energy_price, ControlError) < 0:
            raise ControlError(
                f"{where}: expected a number of at least 0, K, got {self.energy_price:g}"
            )


@final
class RangeCost(AbstractEvennessCost):
    r"""The difference between the hottest and the coldest point, $\max_i y_i - \min_i y_i$.

    **Arguments:**

    - `energy_price`: the range that a unit of duty is worth, K.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "range"
    has_free_centre: ClassVar[bool] = True
    energy_price: float = eqx.field(static=True, default=0.0)


@final
class WorstPointCost(AbstractEvennessCost):
    r"""Twice the deviation of the point that is farthest from the reference,
    $2 \max_i |y_i - r|$ (minimax).

    **Arguments:**

    - `energy_price`: as in `RangeCost`.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "worst-point"
    energy_price: float = eqx.field(static=True, default=0.0)


@final
class SquaresCost(AbstractEvennessCost):
    r"""The sum of the squared deviations from the reference, $\sum_i (y_i - r)^2 / 2 n$, in K by
    $n$ points. On the way each point is driven to its temperature at rest.

    **Arguments:**

    - `energy_price`: as in `RangeCost`.

    **Raises:** `ControlError` if the price is not a number of at least 0.
    """

    name: ClassVar[str] = "squares"
    is_quadratic: ClassVar[bool] = True
    energy_price: float = eqx.field(static=True, default=0.0)


# Name in controller files -> class.
EVENNESS_COSTS: Mapping[str, type[RangeCost] | type[WorstPointCost] | type[SquaresCost]] = {
    cost.name: cost for cost in (RangeCost, WorstPointCost, SquaresCost)
}
