"""Refuses parameter values with which a simulation has no meaning."""

from functools import lru_cache

from .._errors import ParameterError
from ..physics import Twin, build_netlist
from ..rig import Rig, Value


def check_values(twin: Twin) -> None:
    """Checks that all resistances, heat capacities, lags, delays and current limits are above 0. A
    simulation with a negative one may still give finite temperatures.

    **Raises:** `ParameterError` that names the quantity.
    """
    values = twin.numbers_si
    for what, value in _positive_values(twin.rig):
        found = value.evaluate(values)
        # A power of a negative number, such as a negative fan speed, is complex.
        if isinstance(found, complex) or found <= 0:
            raise ParameterError(
                f"{twin.rig.name}: {what} ({value}): expected a value above 0, got {found:g} in "
                "SI units"
            )


@lru_cache(maxsize=32)
def _positive_values(rig: Rig) -> tuple[tuple[str, Value], ...]:
    """Returns the distinct values of a rig that must be above 0, each with a description."""
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
