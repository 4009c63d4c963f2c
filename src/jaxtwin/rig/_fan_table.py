"""The field `fan` of a cell or of a link in a rig file: a thermal resistance that falls with the
speed of a fan."""

from ._fields import Fields
from ._input import Switched
from ._schema import FanTable
from ._units import FACTOR
from ._value import Value


def blown(
    resistance: Value | Switched, fan: FanTable | None, at: str, fields: Fields
) -> Value | Switched:
    r"""A resistance to air that a fan moves, $R n^{-m}$, K/W.

    The fan's speed $n$ may be an input, which may be 0: no heat then passes this resistance. It is
    relative to the speed for which the resistance $R$ is stated. The
    velocity of the air is proportional to it, and heat transfer to air that flows along a surface
    rises with its velocity to the power of $m$ = 1/2 if the flow is laminar (Pohlhausen), of 4/5
    if it is turbulent.

    **Arguments:**

    - `resistance`: $R$, K/W. `fan`: the table of the fan; None without a fan.
    - `at`: the place of the table `fan` in the file, for messages.

    **Raises:** `RigError` if the speed is no number above 0.
    """
    if fan is None:
        return resistance
    speed = fields.input_or_value(f"{at}.fan.speed", fan.speed, FACTOR)
    return resistance * speed**-fan.exponent
