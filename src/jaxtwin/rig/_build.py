"""Reads rig files: builds a `Rig` from the tables of a file. Types are checked first, then units,
names and geometry, and at last whether heat has a path from each node to the surroundings.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .._arguments import path_of
from .._celsius import COLDEST_ROOM, HOTTEST_ROOM, ZERO_CELSIUS
from .._name_suggestions import unknown_name
from .._twin_address import TwinAddress, read_stored_fit, twin_address
from ..errors import RigError
from ._bodies import (
    Body,
    Circuit,
    CircuitLink,
    NonlinearLink,
    build_bodies,
    build_circuit,
    build_links,
)
from ._cell import Cell, build_cell
from ._fields import Fields
from ._heater import Heater, build_heater, heater_bodies, heater_links
from ._instruments import Sensors, build_camera, build_channel, build_driver, build_limits
from ._parameter_table import build_inputs, build_parameter_sets, build_parameters
from ._plate import AMBIENT, NO_PLATE, Plate, build_plate
from ._rig import Rig
from ._sensors import ZoneSensor
from ._toml import bundled_content, bundled_rigs, file_content, parse_toml, refuse
from ._units import NOISE, TEMPERATURE, TEMPERATURE_RATE
from ._value import Parameter, Value

if TYPE_CHECKING:
    from ._schema import RigTable


def load_rig(name_or_path: Rig | str | os.PathLike[str]) -> Rig:
    """Reads a rig file and checks it.

    **Arguments:**

    - `name_or_path`: the name of a bundled rig (`bundled_rigs()`), or the path of a rig file; a rig
      that was read is returned as it is.

    **Returns:** the rig, with all values in SI units except those of the parameter table, which
    keeps its units.

    **Raises:** `RigError` for the first mistake, naming file, field, what was expected and what
    was found.
    """
    if isinstance(name_or_path, Rig):
        return name_or_path
    if twin_address(name_or_path) is not None:
        refuse(
            os.fspath(name_or_path),
            "",
            "expected a rig, got a twin of a store, which is a rig with values; Twin(address) and "
            "Fit.load(address) read it, and --parameters takes its values, beside the rig",
        )
    place = path_of("load_rig", name_or_path, RigError)
    name = os.fspath(name_or_path)
    if name in bundled_rigs():
        return parse_rig(*bundled_content("rigs", name))
    if not place.exists():
        refuse(name, "", f"no such file, {unknown_name('bundled rig', name, bundled_rigs())}")
    content, source = file_content(place)
    data = parse_toml(content, source)
    if "parameters" in data and not {"plate", "cells", "driver", "channels"} & data.keys():
        refuse(
            source,
            "",
            "expected a rig file, got a parameter file, such as a saved fit; Fit.load reads a fit, "
            "and Twin(rig, file) or --parameters takes its values, beside the rig that it is of",
        )
    return parse_rig(content, source)


def rig_from_tables(tables: Mapping[str, Any], source: str) -> Rig:
    """The rig that the tables of a rig file describe, for a program that writes or changes them.

    The rig has no `text`: a saved fit of it does not hold its rig file, and neither its grid nor
    the places of its cells can be changed afterwards.

    **Arguments:**

    - `tables`: tables, lists and texts as `tomllib.loads` reads them.
    - `source`: what error messages call the rig file.

    **Raises:** `RigError` for the first mistake, as `load_rig` does.
    """
    return build_rig(dict(tables), source)


def rig_of_stored_twin(address: TwinAddress) -> Rig:
    """The rig of a twin in a store, from the text of its rig file.

    **Raises:** `RigError` if the store has no such twin.
    """
    source = f"{address.file}@{address.name}"
    data = parse_toml(read_stored_fit(address, RigError), source)
    return parse_rig(data["fit"]["rig_text"].encode(), data["fit"]["rig_file"])


def parse_rig(content: bytes, source: str) -> Rig:
    """The rig that a rig file describes.

    **Arguments:**

    - `content`: the content of the file.
    - `source`: the file, for messages.

    **Raises:** `RigError` for the first mistake.
    """
    data = parse_toml(content, source)
    return replace(build_rig(data, source), text=content.decode("utf-8-sig"))


def build_rig(data: dict[str, Any], source: str) -> Rig:
    """The rig that the tables of a rig file describe.

    **Arguments:**

    - `data`: the file's tables, as `tomllib` reads them.
    - `source`: the file, for messages.

    **Raises:** `RigError` for the first mistake.
    """
    from ._schema import (  # with pydantic, which only readers of a rig should pay for
        RigTable,
        validate,
    )

    table = validate(RigTable, data, source)
    parameters = build_parameters(table, source)
    sets = build_parameter_sets(table, parameters, source)
    inputs = build_inputs(table.inputs, parameters, source)
    fields = Fields(source, parameters, sets, inputs)
    if not table.cells and not table.heaters:
        fields.refuse("cells", "expected [[cells]] or [[heaters]], got neither")
    fields.check_unique("cells", [cell.name for cell in table.cells])
    fields.check_unique("heaters", [part.name for part in (*table.cells, *table.heaters)])
    fields.check_unique("channels", [channel.name for channel in table.channels])
    if (table.camera is None) == (table.sensors is None):
        result = "neither a camera nor sensors" if table.camera is None else "both"
        fields.refuse("camera", f"expected either [camera] or [sensors], got {result}")
    if table.plate is None:
        _check_needs_no_plate(table, fields)
    plate = table.plate and build_plate(table.plate, table.circuit is not None, fields)
    plate = plate or NO_PLATE
    circuit = table.circuit and build_circuit(table.circuit, plate, fields)
    bodies = build_bodies(table.bodies, plate, fields)
    bodies += heater_bodies(table.heaters, plate, bodies, fields)
    links = build_links(table.links, plate, bodies, fields)
    links += tuple(heater_links(table.heaters, plate, bodies, fields))
    cells = tuple(build_cell(cell, plate, bodies, fields) for cell in table.cells)
    heaters = tuple(build_heater(heater, plate, bodies, fields) for heater in table.heaters)
    check_grounded(plate, circuit, cells, heaters, bodies, links, fields)
    ambient = initial = fields.value("ambient.temperature", table.ambient.temperature, TEMPERATURE)
    _check_room(ambient, parameters, fields)
    if table.initial is not None and table.initial.temperature is not None:
        initial = fields.value("initial.temperature", table.initial.temperature, TEMPERATURE)
    nodes = {} if table.initial is None else table.initial.nodes
    rig = Rig(
        name=table.name,
        title=table.title,
        description=table.description.strip(),
        references=tuple(table.references),
        plate=plate,
        circuit=circuit,
        cells=cells,
        heaters=heaters,
        bodies=bodies,
        links=links,
        inputs=inputs,
        driver=build_driver(table.driver, cells, heaters, fields),
        camera=table.camera and build_camera(table.camera, fields),
        channels=tuple(build_channel(channel, plate, bodies, fields) for channel in table.channels),
        ambient_temperature=ambient,
        initial_temperature=initial,
        initial_nodes=tuple(
            (name, fields.value(f"initial.nodes.{name}", text, TEMPERATURE))
            for name, text in nodes.items()
        ),
        parameters=parameters,
        parameter_sets=sets,
        source=source,
        limits=table.limits and build_limits(table.limits, fields),
        ambient_drift=fields.optional("ambient", table.ambient, "drift", TEMPERATURE_RATE),
        sensors=table.sensors
        and Sensors(fields.constant("sensors.noise", table.sensors.noise, NOISE)),
    )
    if rig.camera is not None and rig.camera.registration is not None:
        for channel in rig.channels:
            if not isinstance(channel.sensor, ZoneSensor):
                fields.refuse(
                    f"channels[{channel.name}]",
                    "expected ranges x and y, because a [camera.registration] moves what channels "
                    f"look at, got a sensor of kind {channel.sensor.kind!r}",
                )
    if rig.camera is not None:
        for channel in rig.channels:
            for body in bodies:  # without any, no weights are computed, which need JAX's types
                if body.name in channel.sensor.weights(plate):
                    fields.refuse(
                        f"channels[{channel.name}].nodes",
                        f"expected elements of the plate, which the [camera] sees, got the body "
                        f"{body.name!r}",
                    )
            if channel.lag is not None:
                fields.refuse(
                    f"channels[{channel.name}].lag",
                    "expected [sensors] beside a lag, got a [camera], which sees the plate at once",
                )
    fields.check_all_used()
    return rig


def _check_needs_no_plate(table: "RigTable", fields: Fields) -> None:
    for part in ("circuit", "camera"):
        if getattr(table, part) is not None:
            fields.refuse(
                part,
                f"expected none in a rig without a [plate], got one; {_WITHOUT_PLATE[part]}",
            )


_WITHOUT_PLATE = {
    "circuit": "[[links]] connect bodies",
    "camera": "give [sensors], whose channels name bodies",
}


def _check_room(ambient: Value, parameters: Mapping[str, Parameter], fields: Fields) -> None:
    """Refuses a room that is none, such as 20 K."""
    room = float(ambient.evaluate({name: p.to_si(p.value) for name, p in parameters.items()}))
    if not COLDEST_ROOM <= room - ZERO_CELSIUS <= HOTTEST_ROOM:
        fields.refuse(
            "ambient.temperature",
            f"expected the temperature of a room, {COLDEST_ROOM:g} to {HOTTEST_ROOM:g} degC, got "
            f"{room - ZERO_CELSIUS:.10g} degC, which is {room:.10g} K; is the unit the other one?",
        )


def check_grounded(
    plate: Plate,
    circuit: Circuit | None,
    cells: Sequence[Cell],
    heaters: Sequence[Heater],
    bodies: Sequence[Body],
    links: Sequence[CircuitLink | NonlinearLink],
    fields: Fields,
) -> None:
    """Refuses a part of the rig whose heat has no path to the surroundings or to a body at a fixed
    temperature: it has no steady state.

    **Arguments:** the parts of the rig.

    **Raises:** `RigError` that names the part.
    """
    pairs = [*_of_plate(plate, circuit), *_of_cells(cells)]
    pairs += [pair for link in links for pair in link.between]
    held = {AMBIENT, *(body.name for body in bodies if body.temperature is not None)}
    reached = _reached(held, pairs)
    for element in plate.element_names:
        if element not in reached:
            fields.refuse(
                "circuit.links",
                f'expected a path from each node to "{AMBIENT}", got none from {element}; add a '
                "link",
            )
    warmed = {heater.name for heater in heaters}
    for body in bodies:
        if body.name not in reached:
            part = "heaters" if body.name in warmed else "bodies"
            to = "to the plate, " if plate.columns else ""
            fields.refuse(
                f"{part}[{body.name}]",
                f"expected a path for its heat {to}to ambient or to a body that is held at a "
                "temperature, got none; add a link",
            )
    for cell in cells:
        if _name(cell) not in reached:
            fields.refuse(
                f"cells[{cell.name}]",
                "expected a path for its heat to ambient or to a body that is held at a "
                "temperature, got none; give it a sink_resistance",
            )


def _of_plate(plate: Plate, circuit: Circuit | None) -> Iterator[tuple[str, str]]:
    if circuit is None:  # the film of the outer edges, and conduction between the elements
        yield from ((element, AMBIENT) for element in plate.element_names)
        return
    for link in circuit.links:
        yield from link.between


def _of_cells(cells: Sequence[Cell]) -> Iterator[tuple[str, str]]:
    """The paths through the cells, whose two sides are taken together."""
    for cell in cells:
        yield from ((node, _name(cell)) for node, _ in cell.contacts)
        is_isolated = cell.sink_capacitance is not None and cell.sink_air_resistance is None
        if cell.sink_resistance is not None and not is_isolated:
            yield _name(cell), cell.sink or AMBIENT


def _name(cell: Cell) -> str:
    return f"cells[{cell.name}]"  # which no body has


def _reached(start: set[str], pairs: Sequence[tuple[str, str]]) -> set[str]:
    neighbours: dict[str, set[str]] = {}
    for first, second in pairs:
        neighbours.setdefault(first, set()).add(second)
        neighbours.setdefault(second, set()).add(first)
    reached, waiting = set(start), list(start)
    while waiting:
        new = neighbours.get(waiting.pop(), set()) - reached
        reached |= new
        waiting += new
    return reached


DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a rig file.

    It describes tables, keys and types. Units, the names of parameters, nodes and modules, and
    conditions on several fields are checked only by `load_rig`.
    """
    from ._schema import RigTable  # with pydantic, which only readers of a rig should pay for

    result: dict[str, Any] = {"$schema": DIALECT, **_without_null(RigTable.model_json_schema())}
    result["title"] = "jaxtwin rig file"
    result["description"] = (
        "A thermal rig: plate or bodies, cells, heaters, driver, camera or sensors, channels and "
        "parameters."
    )
    return result


def _without_null(part: object) -> Any:
    """The schema without the value null, which TOML does not have."""
    if isinstance(part, list):
        return [_without_null(item) for item in part if item != {"type": "null"}]
    if not isinstance(part, dict):
        return part
    kept = {
        key: _without_null(item)
        for key, item in part.items()
        if not (key == "default" and item is None)
    }
    choices = kept.get("anyOf")
    if isinstance(choices, list) and len(choices) == 1:
        del kept["anyOf"]
        kept = choices[0] | kept
    return kept
