"""The rig: everything that a rig file documents, checked and in SI units."""

import hashlib
import html
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import final

from .._celsius import ZERO_CELSIUS
from ..errors import JaxtwinError
from ._bodies import Body, Circuit, CircuitLink, NonlinearLink
from ._cell import Cell
from ._heater import Heater, RelayWindow
from ._instruments import SOLDER, Camera, Channel, CommonError, Driver, Limits, Sensors
from ._placement import Placement
from ._plate import Plate
from ._value import Input, Parameter, Value, nominal_inputs

# The name of a cell or heater that is a number.
_NUMBERED = re.compile(r"P([1-9]\d{0,3})")


@final
@dataclass(frozen=True, repr=False)
class Rig:
    """A documented physical asset, made by `load_rig`.

    **Arguments:**

    - `name`, `title`, `description`, `references`: its name, a title, a description, and the
      publications that describe it.
    - `plate`: the sizes of the plate, and its material if the circuit follows from it. A rig that
      has none has a plate of no elements: `has_plate`.
    - `circuit`: the plate's circuit if it is stated link by link, otherwise None.
    - `cells`, `heaters`, `driver`, `channels`: the other parts.
    - `camera`: the camera that reads the channels; `None` if `sensors` read them.
    - `ambient_temperature`, `initial_temperature`: the temperature of the surroundings, and that of
      the plate at the start, K.
    - `parameters`: the parameter table, name -> `Parameter`, in the order of the file.
    - `parameter_sets`: named sets of values, set -> name -> value in the parameter's unit.
    - `source`: the file that it was read from. `text`: the text of that file.
    - `limits`: the limits beyond which the cells are switched off; `None` for a rig that must not
      be driven.
    - `sensors`: the point sensors that read the channels; `None` if a camera reads them.
    - `bodies`, `links`: the bodies beside the plate and the cells, and the links that connect them.
      A heater with a heat capacity is one of the bodies.
    - `ambient_drift`: the rate at which the ambient temperature changes from the first sample on,
      K/s; `None` for a constant one.
    - `initial_nodes`: pairs (name of a node, its own temperature at the start, K).
    - `inputs`: the inputs besides the duty, such as the state of a lid.
    """

    name: str
    title: str
    description: str
    references: tuple[str, ...]
    plate: Plate
    circuit: Circuit | None
    cells: tuple[Cell, ...]
    driver: Driver
    camera: Camera | None
    channels: tuple[Channel, ...]
    ambient_temperature: Value
    initial_temperature: Value
    parameters: Mapping[str, Parameter]
    parameter_sets: Mapping[str, Mapping[str, float]]
    source: str
    text: str = field(default="", repr=False, compare=False)
    limits: Limits | None = None
    ambient_drift: Value | None = None
    sensors: Sensors | None = None
    bodies: tuple[Body, ...] = ()
    links: tuple[CircuitLink | NonlinearLink, ...] = ()
    inputs: tuple[Input, ...] = ()
    initial_nodes: tuple[tuple[str, Value], ...] = ()
    heaters: tuple[Heater, ...] = ()

    @property
    def has_plate(self) -> bool:
        """Whether the rig has a plate."""
        return bool(self.plate.columns)

    @property
    def driven(self) -> tuple[str, ...]:
        """The names of what the driver feeds, in the order of duty cycles: the cells, then the
        heaters."""
        return tuple(part.name for part in (*self.cells, *self.heaters))

    @property
    def usual_inputs(self) -> dict[str, float]:
        """The values of the other inputs where none is stated, as an `Experiment` takes them: what
        an observer beside the rig assumes, because no device reports them."""
        return {rig_input.name: rig_input.value for rig_input in self.inputs}

    @property
    def full_scales(self) -> dict[str, tuple[float, str]]:
        """What columns of recordings have at full duty, for the cells and heaters that say it: the
        number and W, V or A."""
        parts = (*self.cells, *self.heaters)
        return {part.name: part.full_scale for part in parts if part.full_scale is not None}

    @property
    def relays(self) -> dict[int, RelayWindow]:
        """The relays of the heaters that have one, by the places of these among the `driven`."""
        return {
            place: heater.time_proportional
            for place, heater in enumerate(self.heaters, len(self.cells))
            if heater.time_proportional is not None
        }

    def driven_called(self, name: str) -> str | None:
        """The cell or heater that a recording calls by a name: the one of this name; or else `P2`
        is the second, if its own name is no other number; `None` if there is none."""
        if name in self.driven:
            return name
        number = _NUMBERED.fullmatch(name)
        if number is None or int(number[1]) > len(self.driven):
            return None
        own = self.driven[int(number[1]) - 1]
        return None if _NUMBERED.fullmatch(own) else own

    @property
    def lowest_duty(self) -> tuple[float, ...]:
        """The lowest duty of each of the `driven`: -1 for a cell, which also cools, and 0 for a
        heater."""
        return (-1.0,) * len(self.cells) + (0.0,) * len(self.heaters)

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The places of the cells and heaters that have one, on the plate."""
        result = (part.placement for part in (*self.cells, *self.heaters))
        return tuple(placement for placement in result if placement is not None)

    @property
    def nominal_inputs(self) -> Mapping[str, float]:
        """The numbers of the inputs where none is stated, by the names that a `Value` has for
        them."""
        return nominal_inputs(self.inputs)

    @property
    def common_error(self) -> CommonError | None:
        """The error that all channels of a camera share; `None` without one."""
        return None if self.camera is None else self.camera.common_error

    @property
    def noise(self) -> float:
        """Standard deviation of a reading, of a pixel or a sensor, K."""
        reader = self.camera or self.sensors
        return 0.0 if reader is None else reader.noise

    @property
    def maximum_temperature(self) -> float | None:
        """Highest allowed temperature of a channel, K; `None` if the file states no limits."""
        return None if self.limits is None else self.limits.temperature

    @property
    def maximum_side_temperatures(self) -> tuple[float, ...]:
        """Highest allowed temperature of the sides of each cell and heater, K: that of the file; or
        else the melting point of solder for a cell, and infinite for a heater, which has none."""
        stated = None if self.limits is None else self.limits.cell_temperature
        if stated is not None:
            return (stated,) * len(self.driven)
        solder = SOLDER + ZERO_CELSIUS
        return (solder,) * len(self.cells) + (math.inf,) * len(self.heaters)

    @cached_property
    def fingerprint(self) -> str:
        """The SHA-256 of everything that affects the rig's temperatures except the values of its
        parameters, as hexadecimal digits."""
        words = ("name", "title", "description", "references", "source", "text", "limits")
        values = ("parameters", "parameter_sets")
        names = [part.name for part in fields(self) if part.name not in (*words, *values)]
        equations = {name: getattr(self, name) for name in names}
        units = {name: (row.scale, row.offset) for name, row in self.parameters.items()}
        drives = [
            (heater.name, heater.drive_exponent) for heater in self.heaters if heater.drive_exponent
        ]
        more = (drives,) if drives else ()  # rigs of before keep their fingerprints
        text = repr((equations, units, self.maximum_temperature, *more))
        return hashlib.sha256(text.encode()).hexdigest()

    def __hash__(self) -> int:
        # Dictionaries cannot be hashed. The parts below can, and they distinguish rigs of one name.
        return hash((self.name, self.source, self.plate, self.circuit, self.cells, self.heaters))

    def __repr__(self) -> str:
        part, text = next(iter(_parts(self).items()))
        return f"<Rig {self.name!r}: {text if self.has_plate else f'{part} {text}'}>"

    def __str__(self) -> str:
        lines = [f"{self.name}: {self.title}"]
        return "\n".join(lines + [f"  {part}: {text}" for part, text in _parts(self).items()])

    def _repr_html_(self) -> str:
        return _html(self)


def _parts(rig: Rig) -> dict[str, str]:
    """The parts of a rig, part -> one line of text."""
    plate = rig.plate
    circuit = "by finite volumes"
    if rig.circuit is not None:
        count = sum(len(link.between) for link in rig.circuit.links)
        circuit = f"given, {count} resistance{'s' * (count != 1)} on the plate"
    free = sum(parameter.free for parameter in rig.parameters.values())
    parts = {
        "plate": (
            f"{100 * plate.width:g} cm x {100 * plate.height:g} cm, "
            f"{len(plate.rows)} x {len(plate.columns)} elements, circuit {circuit}"
        )
        if rig.has_plate
        else "",
        "cells": ", ".join(f"{cell.name} {_place_text(cell)}" for cell in rig.cells),
        "heaters": ", ".join(_heater_text(heater) for heater in rig.heaters),
        "bodies": ", ".join(body.name for body in rig.bodies),
    }
    return {
        **{part: text for part, text in parts.items() if text},
        "driver": f"{rig.driver.averaging} averaging, {rig.driver.counts} counts",
        **({"inputs": ", ".join(rig_input.name for rig_input in rig.inputs)} if rig.inputs else {}),
        "channels": " ".join(channel.name for channel in rig.channels),
        "parameters": f"{len(rig.parameters)}, {free} of them free",
        "parameter sets": ", ".join(rig.parameter_sets) or "none",
        "file": rig.source,
    }


def _place_text(part: Cell | Heater) -> str:
    """Where a cell or heater is: on the elements and bodies that it touches, or at a place."""
    place = part.placement
    if place is not None:
        x, y = (
            f"{100 * at.factor:g} cm" if at.is_constant else str(at) for at in (place.x, place.y)
        )
        return f"at {x}, {y}"
    if isinstance(part, Heater):
        return "" if part.node == part.name else f"on {part.node}"
    return f"on {' '.join(node for node, _ in part.contacts)}"


def _heater_text(heater: Heater) -> str:
    power, resistance = heater.power, heater.electrical_resistance
    size = f"{resistance} ohm" if power is None else f"{power} W"
    return " ".join(part for part in (heater.name, _place_text(heater), f"({size})") if part)


def _html(rig: Rig) -> str:
    """A rig as a heading and two tables: its parts and its parameters."""
    parts = "".join(_row(part, text) for part, text in _parts(rig).items())
    parameters = "".join(
        _row(
            p.name,
            f"{p.value:g}",
            p.unit,
            f"{p.lower:g} … {p.upper:g}",
            "free" if p.free else "fixed",
            p.scope,
            p.description,
        )
        for p in rig.parameters.values()
    )
    heading = "".join(
        f"<th>{name}</th>"
        for name in ("parameter", "value", "unit", "bounds", "", "scope", "description")
    )
    return (
        f"<b>{html.escape(rig.name)}</b>: {html.escape(rig.title)}<table>{parts}</table>"
        f"<details><summary>parameters</summary>"
        f"<table><tr>{heading}</tr>{parameters}</table></details>"
    )


def _row(*cells: str) -> str:
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"


# The refusal of a rig without a plate by what shows or measures one.


def check_has_plate(where: str, rig: Rig, error: type[JaxtwinError]) -> None:
    """Refuses a rig that has no plate.

    **Raises:** `error`.
    """
    if not rig.has_plate:
        raise error(f"{where}: expected a rig with a plate, got {rig.name}, which has none")
