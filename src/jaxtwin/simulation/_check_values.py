"""Values that a simulation cannot take."""

from functools import lru_cache

from .._errors import ParameterError
from ..physics import Twin, build_netlist
from ..rig import Rig, Value


def check_values(twin: Twin) -> None:
    """What has no meaning as a resistance or a heat capacity may still give finite temperatures."""
    values = twin.numbers_si
    for what, value in _positive_values(twin.rig):
        found = value.evaluate(values)
        # Powers of what is below 0, such as a fan's speed, are not real.
        if isinstance(found, complex) or found <= 0:
            raise ParameterError(
                f"{twin.rig.name}: {what} ({value}): expected a value above 0, got {found:g} in "
                "SI units"
            )


@lru_cache(maxsize=32)
def _positive_values(rig: Rig) -> tuple[tuple[str, Value], ...]:
    """Each distinct value of a rig that must be above 0, and what it is."""
    netlist = build_netlist(rig)
    named = [(f"lag of {c.name}", c.lag) for c in rig.channels if c.lag is not None]
    named += [(f"capacitance of {node.name}", node.capacitance) for node in netlist.nodes]
    for link in netlist.links:
        named += [(f"resistance {link.a} - {link.b}", value) for value in link.resistances]
    named += [
        (f"electrical resistance of {c.name}", c.electrical_resistance) for c in netlist.cells
    ]
    driver = rig.driver
    named += [
        (f"{what} of the driver", value)
        for what, value in (
            ("lag", driver.lag),
            ("delay", driver.delay),
            ("current limit", driver.current_limit),
        )
        if value is not None
    ]
    first: dict[Value, str] = {}
    for what, value in named:
        if not value.is_constant:
            first.setdefault(value, what)
    return tuple((what, value) for value, what in first.items())
