"""Degrees Celsius and kelvin."""

# 0 degC, K. Physics computes in kelvin; what a person reads is in degC.
ZERO_CELSIUS = 273.15

# The coldest and the hottest surroundings of a rig, degC: liquid nitrogen, the inside of an oven.
# In K every room is hotter, and 20 degC that are called K are colder.
COLDEST_ROOM, HOTTEST_ROOM = -200.0, 150.0

# How far from its room a warm rig is at most, K, where a temperature may have been given in K.
NEAR_ROOM = 60.0


def is_probably_kelvin(temperature: float, room: float) -> bool:
    """Whether a temperature at the start, which should be in degC, is near the room (degC) if it is
    taken for kelvin, and far from it otherwise."""
    is_near = abs(temperature - ZERO_CELSIUS - room) < NEAR_ROOM
    return is_near and abs(temperature - room) > NEAR_ROOM
