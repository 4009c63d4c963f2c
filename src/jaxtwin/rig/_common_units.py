"""The units that most rig files use.

They are read without pint, whose import and definitions take 0.4 s of a first call. A test compares
each unit with pint, which reads all other units.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, final

from .._celsius import ZERO_CELSIUS


@final
class Unit(NamedTuple):
    """Scale and offset to SI units, and the powers of the base dimensions, by pint's names."""

    scale: float
    offset: float
    dimensions: Mapping[str, float]


_BASES = ("[mass]", "[length]", "[time]", "[current]", "[temperature]")


def _unit(scale: float, *powers: int, offset: float = 0.0) -> Unit:
    pairs = zip(_BASES, powers, strict=True)
    return Unit(scale, offset, {base: power for base, power in pairs if power})


# The powers are those of kg, m, s, A and K.
COMMON_UNITS = MappingProxyType(
    {
        "": _unit(1.0, 0, 0, 0, 0, 0),
        "m": _unit(1.0, 0, 1, 0, 0, 0),
        "cm": _unit(0.01, 0, 1, 0, 0, 0),
        "mm": _unit(0.001, 0, 1, 0, 0, 0),
        "um": _unit(1e-6, 0, 1, 0, 0, 0),
        "m^2": _unit(1.0, 0, 2, 0, 0, 0),
        "cm^2": _unit(1e-4, 0, 2, 0, 0, 0),
        "mm^2": _unit(1e-6, 0, 2, 0, 0, 0),
        "rad": _unit(1.0, 0, 0, 0, 0, 0),
        "deg": _unit(math.pi / 180, 0, 0, 0, 0, 0),
        "kg": _unit(1.0, 1, 0, 0, 0, 0),
        "g": _unit(0.001, 1, 0, 0, 0, 0),
        "s": _unit(1.0, 0, 0, 1, 0, 0),
        "A": _unit(1.0, 0, 0, 0, 1, 0),
        "V": _unit(1.0, 1, 2, -3, -1, 0),
        "ohm": _unit(1.0, 1, 2, -3, -2, 0),
        "mohm": _unit(0.001, 1, 2, -3, -2, 0),
        "W": _unit(1.0, 1, 2, -3, 0, 0),
        "K": _unit(1.0, 0, 0, 0, 0, 1),
        "degC": _unit(1.0, 0, 0, 0, 0, 1, offset=ZERO_CELSIUS),
        "K/W": _unit(1.0, -1, -2, 3, 0, 1),
        "W/K": _unit(1.0, 1, 2, -3, 0, -1),
        "K/s": _unit(1.0, 0, 0, -1, 0, 1),
        "K/hour": _unit(1 / 3600, 0, 0, -1, 0, 1),
        "V/K": _unit(1.0, 1, 2, -3, -1, -1),
        "J/K": _unit(1.0, 1, 2, -2, 0, -1),
        "J/(kg K)": _unit(1.0, 0, 2, -2, 0, -1),
        "W/(m K)": _unit(1.0, 1, 1, -3, 0, -1),
        "W/(m^2 K)": _unit(1.0, 1, 0, -3, 0, -1),
        "m^2/s": _unit(1.0, 0, 2, -1, 0, 0),
        "kg/m^3": _unit(1.0, 1, -3, 0, 0, 0),
    }
)
