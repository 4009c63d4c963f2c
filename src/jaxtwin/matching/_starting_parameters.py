"""The parameters that say how a recording begins: the temperatures of room, plate and what no
reading shows."""

from collections.abc import Mapping

from ..rig import Rig, Value

ABSOLUTE_ZERO = -273.15


def names_in(*values: Value | None) -> frozenset[str]:
    """Names of the parameters on which some values depend."""
    return frozenset(name for value in values if value is not None for name, _ in value.powers)


def room_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the room temperature at the start, if a recording
    holds none."""
    return names_in(rig.ambient_temperature)


def plate_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the plate's temperature at the start, unless they are
    those of the room."""
    return names_in(rig.initial_temperature) - room_parameters(rig)


def hidden_parameters(rig: Rig) -> frozenset[str]:
    """Names of the parameters that determine the temperatures of sinks, bodies and cells at the
    start; not those of room or plate."""
    starts = [
        value for c in rig.cells for value in (c.initial_temperature, c.sink_initial_temperature)
    ]
    starts += [body.initial_temperature for body in rig.bodies]
    return names_in(*starts) - room_parameters(rig) - plate_parameters(rig)


def replaced_by_recorded_room(rig: Rig) -> frozenset[str]:
    """Names of the parameters that have no effect on a recording that holds an ambient
    temperature."""
    own = names_in(rig.ambient_temperature, rig.ambient_drift)
    others = [rig.initial_temperature]
    for cell in rig.cells:
        others += [cell.initial_temperature, cell.sink_initial_temperature]
    for body in rig.bodies:
        others += [body.initial_temperature, body.temperature]
    return own - names_in(*others)


def room_temperature(rig: Rig, values_si: Mapping[str, float], recorded: float | None) -> float:
    """The room temperature at the start, degC: the recorded one, or that of the twin."""
    if recorded is not None:
        return recorded
    return float(rig.ambient_temperature.evaluate(values_si)) + ABSOLUTE_ZERO
