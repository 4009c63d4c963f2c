"""Degrees Celsius and kelvin."""

ZERO_CELSIUS = 273.15
"""0 degC, K. Physics computes in kelvin; what a person reads is in degC."""

NEAR_ROOM = 60.0
"""How far from its room a warm rig is at most, K, where a temperature may have been given in K."""


def is_probably_kelvin(temperature: float, room: float) -> bool:
    """Whether a temperature at the start, which should be in degC, is near the room (degC) if it is
    taken for kelvin, and far from it otherwise."""
    is_near = abs(temperature - ZERO_CELSIUS - room) < NEAR_ROOM
    return is_near and abs(temperature - room) > NEAR_ROOM
