"""Degrees Celsius and kelvin."""

ZERO_CELSIUS = 273.15
"""0 degC, K. Physics computes in kelvin; what a person reads is in degC."""
