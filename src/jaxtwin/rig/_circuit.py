"""A plate circuit given link by link."""

from dataclasses import dataclass
from typing import final

from ._input import Switched
from ._value import Value


@final
@dataclass(frozen=True)
class CircuitLink:
    """A named resistance, and the pairs of nodes that it connects.

    **Arguments:**

    - `resistance`: K/W, or one for each state of an input.
    - `factor`: each link has factor times the resistance.
    - `between`: pairs of node names (plate elements, bodies or "ambient"). A pair may occur more
      than once: an edge element can lose heat to the surroundings in several ways.
    """

    resistance: Value | Switched
    factor: float
    between: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class NonlinearLink:
    """Natural convection, radiation or both between the two nodes of each pair; what a resistance
    carries beside them is a `CircuitLink`.

    **Arguments:**

    - `convection`: the conductance of natural convection at a temperature difference of
      `FILM_REFERENCE`, W/K; it grows with the difference to the power of `exponent`. None for no
      convection.
    - `exponent`: dimensionless.
    - `radiating_area`: emissivity times area, m^2; None for no radiation.
    - `between`: pairs of names as in `CircuitLink`.
    """

    convection: Value | None
    exponent: Value
    radiating_area: Value | None
    between: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class Circuit:
    """The plate as an explicit network of equal capacitances and named resistances.

    **Arguments:**

    - `capacitance`: the heat capacity of every plate element, J/K.
    - `links`: groups of links that share a resistance.
    """

    capacitance: Value
    links: tuple[CircuitLink, ...]
