"""Bodies beside the plate and its cells, such as a second plate, a common sink or coolant."""

from dataclasses import dataclass
from typing import final

from ._value import Value


@final
@dataclass(frozen=True)
class Body:
    """A body of uniform temperature, which links and cells connect to the rest of a rig.

    **Arguments:**

    - `name`: unique among bodies and plate elements.
    - `capacitance`: the heat capacity, J/K; None for a body at a fixed temperature.
    - `temperature`: the fixed temperature of a body such as coolant or an ice bath, K; None for a
      body with a heat capacity.
    - `initial_temperature`: the temperature at the start, K; None means that of the plate.
    """

    name: str
    capacitance: Value | None = None
    temperature: Value | None = None
    initial_temperature: Value | None = None
