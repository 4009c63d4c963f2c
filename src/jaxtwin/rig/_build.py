"""Builds a `Rig` from the tables of a rig file: types are checked first, then units, names and
geometry, part by part."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from .._celsius import COLDEST_ROOM, HOTTEST_ROOM, ZERO_CELSIUS
from ._bench_table import build_camera, build_driver, build_limits
from ._body_table import build_bodies, build_links
from ._bundled import parse_toml
from ._camera import Sensors
from ._cell_table import build_cell
from ._channel import build_channel
from ._circuit_table import build_circuit
from ._fields import Fields
from ._grounding import check_grounded
from ._heater_table import build_heater, heater_bodies, heater_links
from ._input_table import build_inputs
from ._parameter import Parameter
from ._parameter_table import build_parameter_sets, build_parameters
from ._plate import NO_PLATE
from ._plate_table import build_plate
from ._rig import Rig
from ._schema import RigTable
from ._units import NOISE, TEMPERATURE, TEMPERATURE_RATE
from ._validate import validate
from ._value import Value
from ._zone_sensor import ZoneSensor


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
        ambient_drift=None
        if table.ambient.drift is None
        else fields.value("ambient.drift", table.ambient.drift, TEMPERATURE_RATE),
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


def _check_needs_no_plate(table: RigTable, fields: Fields) -> None:
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
