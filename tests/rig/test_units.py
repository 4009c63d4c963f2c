"""Text with a unit -> SI: conversions known by hand, and whatever else a text may hold."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.rig import _units as units
from jaxtwin.rig._units import COMMON_UNITS, parse_quantity, unit_scale


@pytest.mark.parametrize("unit", COMMON_UNITS)
def test_a_common_unit_is_what_pint_says(unit):
    assert COMMON_UNITS[unit] == units._unit_by_pint(unit)


def test_the_units_of_all_kinds_are_common():
    kinds = [value for value in vars(units).values() if isinstance(value, units.Kind)]
    assert {kind.unit for kind in kinds} <= COMMON_UNITS.keys()


@pytest.mark.parametrize(
    ("text", "kind", "number"),
    [
        ("4 cm", units.LENGTH, 0.04),
        ("0.5 inch", units.LENGTH, 0.0127),
        ("1e-3m", units.LENGTH, 0.001),
        ("13.5 g", units.MASS, 0.0135),
        ("8.96 g/cm^3", units.DENSITY, 8960),
        ("390 J/(kg K)", units.SPECIFIC_HEAT, 390),
        ("0.39 kJ/kg/K", units.SPECIFIC_HEAT, 390),
        ("4.01 W/(cm K)", units.CONDUCTIVITY, 401),
        ("75 W/(m^2 K)", units.FILM_COEFFICIENT, 75),
        ("75 W/m**2/K", units.FILM_COEFFICIENT, 75),
        ("75 W m^-2 K^-1", units.FILM_COEFFICIENT, 75),
        ("0.6 degC/W", units.THERMAL_RESISTANCE, 0.6),
        ("2.65 ohm", units.ELECTRICAL_RESISTANCE, 2.65),
        ("100 mΩ", units.ELECTRICAL_RESISTANCE, 0.1),
        ("50 mV/K", units.SEEBECK_COEFFICIENT, 0.05),
        ("15 degC", units.TEMPERATURE, 288.15),
        ("15 °C", units.TEMPERATURE, 288.15),
        ("-40 degC", units.TEMPERATURE, 233.15),
        ("298 K", units.TEMPERATURE, 298),
        ("90 %", units.FACTOR, 0.9),
        ("1", units.FACTOR, 1),
        ("+.5", units.FACTOR, 0.5),
    ],
)
def test_a_quantity_is_converted_to_si(text, kind, number):
    assert parse_quantity(text, kind) == pytest.approx(number, rel=1e-12)


@given(st.text(alphabet="mkgKWJsA^*/()-+. 0129%µΩ°_~", max_size=20))
def test_any_unit_text_is_a_unit_or_refused(text):
    try:
        scale, offset = unit_scale(text)
    except ValueError:
        return
    assert math.isfinite(scale)
    assert scale > 0
    assert offset in (0, 273.15)


@pytest.mark.slow
@given(st.text(max_size=20))
def test_any_text_is_a_quantity_or_refused(text):
    try:
        number = parse_quantity(text, units.LENGTH)
    except ValueError:
        return
    assert math.isfinite(number)
