"""Bodies beside the plate and its cells: a second plate, a common sink, coolant, a bead."""

from dataclasses import dataclass
from typing import final

from ._value import Value


@final
@dataclass(frozen=True)
class Body:
    """Something at one temperature, which links and cells connect to the rest of a rig.

    **Arguments:**

    - `name`: unique among bodies and plate elements.
    - `capacitance`: its heat capacity, J/K; None for a body that is held at a temperature.
    - `temperature`: what it is held at, whatever heat flows into it, K: coolant, an ice bath.
    - `initial_temperature`: at the start, K; None means that of the plate.
    """

    name: str
    capacitance: Value | None = None
    temperature: Value | None = None
    initial_temperature: Value | None = None
