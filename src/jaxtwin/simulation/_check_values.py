"""Refuses parameter values with which a simulation has no meaning, and names the limits that a run
exceeds."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from .._celsius import COLDEST_ROOM, ZERO_CELSIUS
from ..errors import ParameterError
from ..physics import Twin, build_netlist, placed_names
from ..rig import Rig, Value

if TYPE_CHECKING:
    from ._run import Run


def check_values(twin: Twin, where: str | None = None) -> None:
    """Checks that all resistances, heat capacities, lags, delays and current limits are above 0,
    and that places on the plate are within their bounds. A simulation with others may still give
    finite temperatures.

    **Arguments:**

    - `where`: the origin of the values, for the message; None for the name of the rig.

    **Raises:** `ParameterError` that names the quantity.
    """
    values = {name: np.float64(value) for name, value in twin.numbers_si.items()}
    for what, value, (lowest, highest) in _places(twin.rig):
        result = float(value.evaluate(values))
        if not lowest <= result <= highest:
            raise ParameterError(
                f"{where or twin.rig.name}: {what} ({value}): expected its bounds, "
                f"{100 * lowest:g} cm to {100 * highest:g} cm, got {100 * result:g} cm"
            )
    room = float(twin.rig.ambient_temperature.evaluate(values)) - ZERO_CELSIUS
    if room < COLDEST_ROOM:
        raise ParameterError(
            f"{where or twin.rig.name}: ambient.temperature ({twin.rig.ambient_temperature}): "
            f"expected the temperature of a room, at least {COLDEST_ROOM:g} degC, got {room:.10g} "
            f"degC; is it {room + ZERO_CELSIUS:.10g} degC, called K?"
        )
    values |= _unit_shares(twin.rig)
    for what, value in _positive_values(twin.rig):
        result = _evaluated(value, values)
        if not _is_positive(result):
            raise ParameterError(
                f"{where or twin.rig.name}: {what} ({value}): expected a value above 0, got "
                f"{float(result):g} in SI units"
            )


def valid_draws(
    twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]]
) -> Bool[np.ndarray, " draws"]:
    """Returns which draws `check_values` accepts.

    **Arguments:**

    - `draws`: one or several drawn parameters, name -> values in the unit of the rig's table.
    """
    table, values = twin.rig.parameters, {**twin.values, **draws}
    values_si = {name: table[name].to_si(np.asarray(v, float)) for name, v in values.items()}
    is_valid = np.ones(len(next(iter(draws.values()))), bool)
    for _, value, (lowest, highest) in _places(twin.rig):
        place = value.evaluate(values_si)
        is_valid &= np.asarray((place >= lowest) & (place <= highest))
    values_si |= _unit_shares(twin.rig)
    for _, value in _positive_values(twin.rig):
        is_valid &= _is_positive(_evaluated(value, values_si))
    return is_valid


def check_draw(twin: Twin, draws: Mapping[str, Float[np.ndarray, " draws"]], number: int) -> None:
    """Checks the values of one draw as `check_values` does.

    **Raises:** `ParameterError` that names the draw by its number, counted from 0.
    """
    drawn = {name: values[number] for name, values in draws.items()}
    check_values(twin.with_values(drawn), f"{twin.rig.name}: draw {number}")


def _evaluated(value: Value, values_si: Mapping[str, np.ndarray | np.float64]) -> np.ndarray:
    """The value by the arithmetic of NumPy, without warnings: a power of a negative number, such as
    a negative fan speed, is NaN, and one of 0 may be infinite."""
    with np.errstate(all="ignore"):
        return np.asarray(value.evaluate(values_si))


def _unit_shares(rig: Rig) -> dict[str, np.float64]:
    """1 for each input, the share of each state, and each share that follows from a place on the
    plate, so that every value counts."""
    names = [name for rig_input in rig.inputs for name in rig_input.names]
    return {name: np.float64(1.0) for name in (*names, *placed_names(rig))}


def _places(rig: Rig) -> list[tuple[str, Value, tuple[float, float]]]:
    """The places on the plate that parameters determine: a description, the value, and its range,
    beyond which a cell may touch elements that it has no contact with, m."""
    return [
        (f"{axis} of {placement.name}", value, span)
        for placement in rig.placements
        for axis, value, span in (
            ("x", placement.x, placement.x_range),
            ("y", placement.y, placement.y_range),
        )
        if not value.is_constant
    ]


def _is_positive(value: np.ndarray) -> Bool[np.ndarray, "..."]:
    return np.asarray(np.isfinite(value) & (value > 0))


@lru_cache(maxsize=32)
def _positive_values(rig: Rig) -> tuple[tuple[str, Value], ...]:
    """Returns the distinct values of a rig that must be above 0, each with a description."""
    netlist = build_netlist(rig)
    named = [(f"lag of {c.name}", c.lag) for c in rig.channels if c.lag is not None]
    named += [(f"capacitance of {node.name}", node.capacitance) for node in netlist.nodes]
    for link in netlist.links:
        values = link.resistances or [1 / value for value in link.conductances]
        named += [(f"resistance {link.a} - {link.b}", value) for value in values]
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


# The limits of a rig that a run exceeds.


def exceeded_limits(run: "Run", rig: Rig, recorded: float = -math.inf) -> tuple[str, ...]:
    """A sentence for each kind of limit that is exceeded, about the hottest channel or cell.

    **Arguments:**

    - `recorded`: the hottest reading of the rig itself, degC. Limits below it are left out.
    """
    result = []
    if rig.limits is not None:
        limit = rig.limits.temperature - ZERO_CELSIUS
        if limit >= recorded:
            result += _beyond(run, run.channels, run.temperatures, limit, "the limit of channels")
    given = None if rig.limits is None else rig.limits.cell_temperature
    limit = min(rig.maximum_side_temperatures, default=math.inf) - ZERO_CELSIUS
    if limit < recorded:
        return tuple(result)
    sides = [f"{cell.name}.{side}" for cell in rig.cells for side in ("TC", "TH")]
    if given is not None:  # a heater has no solder between two plates
        sides += [heater.node for heater in rig.heaters]
    states = run.states[:, [run.nodes.index(node) for node in sides]]
    what = "at which solder melts" if given is None else "the limit of cells"
    return (*result, *_beyond(run, tuple(sides), states, limit, what))


def _beyond(
    run: "Run",
    names: tuple[str, ...],
    temperatures: Float[np.ndarray, "times places"],
    limit: float,
    what: str,
) -> list[str]:
    if not names or not temperatures.max() > limit:
        return []
    time, place = np.unravel_index(np.argmax(temperatures), temperatures.shape)
    first = run.time[np.argmax((temperatures > limit).any(axis=1))]
    reached = f"{names[place]} reaches {temperatures[time, place]:.1f} degC"
    return [f"{reached}, above {limit:g} degC, {what}, from {first:g} s on"]
