"""Converts text with a unit to a number in SI units.

The units that most rig files use are read without pint, whose import and definitions take 0.4 s of
a first call. A test compares each of them with pint, which reads all other units.
"""

import functools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, final

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


_INFINITE = re.compile(r"\s*\+?inf\b\s*(.*?)\s*", re.DOTALL)
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_SMALLEST, _LARGEST = 1e-30, 1e30
_EXPONENT = re.compile(r"(\^|\*\*)\s*(-?\d|\(\s*-?\d\s*\))(?!\d)")
_UNIT_TEXT = re.compile(r"(1|[^\W\d]|[%°(])([^\W\d]|[\s*/^()%°\0])*|")


@final
@dataclass(frozen=True)
class Kind:
    """A kind of physical value: what a field of a rig file may hold.

    **Arguments:**

    - `name`: the name with its article, for messages.
    - `unit`: the SI unit.
    - `example`: an example of a value.
    - `least`: `"positive"`, `"zero"` where 0 is allowed too, or `"any"` number.
    - `absolute`: whether it is a point on the temperature scale, which alone may be in degC.
    """

    name: str
    unit: str
    example: str
    least: Literal["positive", "zero", "any"] = "positive"
    absolute: bool = False

    def __str__(self) -> str:
        above = {"positive": " above 0", "zero": " of at least 0", "any": ""}[self.least]
        return f'{self.name}{above}{" K" if self.absolute else ""} such as "{self.example}"'


LENGTH = Kind("a length", "m", "4 cm")
"""A length above 0."""

COORDINATE = Kind("a length", "m", "4 cm", least="zero")
"""A place on the plate, from its left or upper edge: a length of at least 0."""

SHIFT = Kind("a length", "m", "2 mm", least="any")
AREA = Kind("an area", "m^2", "16 cm^2")
ANGLE = Kind("an angle", "rad", "1 deg", least="any")
DENSITY = Kind("a density", "kg/m^3", "8960 kg/m^3")
SPECIFIC_HEAT = Kind("a specific heat", "J/(kg K)", "390 J/(kg K)")
CONDUCTIVITY = Kind("a conductivity", "W/(m K)", "401 W/(m K)")
FILM_COEFFICIENT = Kind("a film coefficient", "W/(m^2 K)", "15 W/(m^2 K)")
FACTOR = Kind("a number without unit", "", "0.9")
EXPONENT = Kind("a number without unit", "", "0.25", least="zero")
DRIVE_EXPONENT = Kind("a number without unit", "", "1.6")
EMISSIVITY = Kind("an emissivity", "", "0.1", least="zero")
DIFFUSIVITY = Kind("a thermal diffusivity", "m^2/s", "1e-4 m^2/s")
DURATION = Kind("a time", "s", "5 s")
SHORTEST = Kind("a time", "s", "1 s", least="zero")
MASS = Kind("a mass", "kg", "13.5 g")
HEAT_CAPACITY = Kind("a heat capacity", "J/K", "17 J/K")
THERMAL_RESISTANCE = Kind("a thermal resistance", "K/W", "0.6 K/W")
CONDUCTANCE = Kind("a thermal conductance", "W/K", "0.2 W/K")
SEEBECK_COEFFICIENT = Kind("a Seebeck coefficient", "V/K", "0.05 V/K", least="zero")
ELECTRICAL_RESISTANCE = Kind("an electrical resistance", "ohm", "2 ohm")
SERIES_RESISTANCE = Kind("an electrical resistance", "ohm", "0.1 ohm", least="zero")
VOLTAGE = Kind("a voltage", "V", "12 V")
CURRENT = Kind("a current", "A", "6.4 A")
POWER = Kind("a heat flow", "W", "33 W")
HEATER_POWER = Kind("a power", "W", "40 W")
TEMPERATURE = Kind("a temperature", "K", "15 degC", absolute=True)
TEMPERATURE_DIFFERENCE = Kind("a temperature difference", "K", "0.1 K")
TEMPERATURE_RATE = Kind("a rate of temperature", "K/s", "0.5 K/hour", least="any")
NOISE = Kind("a temperature difference", "K", "0.1 K", least="zero")


def is_quantity(text: str) -> bool:
    """Whether a text starts with a number and is therefore not a name."""
    return _NUMBER.fullmatch(text) is not None


def is_infinite(text: str, kind: Kind) -> bool:
    """Whether a text is an infinite quantity of a kind, such as `"inf K/W"`.

    **Raises:** `ValueError`, saying what is wrong, if it is infinite and has another unit.
    """
    match = _INFINITE.fullmatch(text)
    if match is None:
        return False
    unit_scale(match[1], kind)
    return True


def parse_quantity(text: str, kind: Kind) -> float:
    """Converts a number with a unit to SI units.

    **Raises:** `ValueError`, saying what is wrong, if the text is no number with a unit of that
    kind. Whether the number is in the range of its kind is left to the caller.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise ValueError("which does not start with a number")
    scale, offset = unit_scale(match[2], kind)
    value = scale * float(match[1]) + offset
    if not math.isfinite(value):
        raise ValueError("which is not a finite number")
    return value


def range_problem(number: float, kind: Kind) -> str | None:
    """The expected range, if a number in SI units is outside the range of its kind; otherwise
    None."""
    if kind.least != "positive" and number == 0:
        return None
    if kind.least == "any":
        number = abs(number)
    if number <= 0:
        return str(kind)
    # Beyond these, products of two values leave the range of floating point.
    if not _SMALLEST <= number <= _LARGEST:
        return f"{_SMALLEST:g} to {_LARGEST:g} in SI units"
    return None


def unit_scale(unit: str, like: Kind | str | None = None) -> tuple[float, float]:
    """Scale and offset with which a number in a unit becomes one in SI units.

    **Arguments:**

    - `unit`: for example `"cm"`, `"W/(m^2 K)"`, `"degC"`; empty for a plain number.
    - `like`: the quantity that it must measure, or a unit of the same kind; None for any quantity.

    **Raises:** `ValueError`, saying what is wrong.
    """
    scale, offset, dimensions = parsed_unit(unit)
    if like is None:
        return scale, offset
    what = f"the unit {unit!r}" if unit else "a number without a unit"
    if dimensions != parsed_unit(like.unit if isinstance(like, Kind) else like).dimensions:
        name = like.name if isinstance(like, Kind) else f"the same as {like!r}"
        raise ValueError(f"{what} does not measure {name}")
    if offset and isinstance(like, Kind) and not like.absolute:
        raise ValueError(f"{what} is a point on a scale, a difference is in K")
    return scale, offset


def parsed_unit(unit: str) -> Unit:
    """Scale and offset of a unit to SI units, and its dimensions.

    **Raises:** `ValueError` if it is unknown.
    """
    return COMMON_UNITS.get(unit) or _unit_by_pint(unit)


@functools.cache
def _unit_by_pint(unit: str) -> Unit:
    # Unit texts come from outside and pint evaluates them: anything but names with one small power
    # each, such as "m**9**9**9", would cost time and memory without bound.
    unknown = ValueError(f"{unit!r} is not a known unit")
    plain = _EXPONENT.sub("\0", unit.replace("\0", "?"))
    if len(unit) > 60 or not _UNIT_TEXT.fullmatch(plain) or re.search(r"\0\s*\0", plain):
        raise unknown
    registry = _registry()
    try:
        parsed = registry.parse_units(unit)
        unity = registry.Quantity(1.0, parsed).to_base_units()
        zero = registry.Quantity(0.0, parsed).to_base_units()
    except Exception:  # whatever pint's parser meets in a text from outside
        raise unknown from None
    scale, offset = float(unity.magnitude - zero.magnitude), float(zero.magnitude)
    if offset:
        if parsed != registry.Unit("degC"):
            raise ValueError(f"{unit!r} does not count from zero, only degC may")
        scale = 1.0  # not 274.15 - 273.15 in floating point
    if not (math.isfinite(scale) and scale > 0):
        raise unknown
    return Unit(scale, offset, dict(parsed.dimensionality))


@functools.cache
def _registry() -> Any:
    import pint  # takes a while, and few rig files need it

    return pint.UnitRegistry()
