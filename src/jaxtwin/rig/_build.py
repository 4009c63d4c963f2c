"""Tables of a rig file -> `Rig`: types first, then units, names and geometry, then the whole."""

from typing import Any

from ._fields import Fields
from ._parameter_table import build_parameter_sets, build_parameters
from ._parts import (
    build_camera,
    build_cell,
    build_channel,
    build_circuit,
    build_driver,
    build_plate,
    check_unique,
)
from ._plate import AMBIENT
from ._rig import Rig
from ._schema import RigTable
from ._units import TEMPERATURE
from ._validate import validate


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
    fields = Fields(source, parameters, sets)
    check_unique("cells", [cell.name for cell in table.cells], fields)
    check_unique("channels", [channel.name for channel in table.channels], fields)
    plate = build_plate(table.plate, table.circuit is not None, fields)
    rig = Rig(
        name=table.name,
        title=table.title,
        description=table.description.strip(),
        references=tuple(table.references),
        plate=plate,
        circuit=None if table.circuit is None else build_circuit(table.circuit, plate, fields),
        cells=tuple(build_cell(cell, plate, fields) for cell in table.cells),
        driver=build_driver(table.driver, fields),
        camera=build_camera(table.camera, fields),
        channels=tuple(build_channel(channel, plate, fields) for channel in table.channels),
        ambient_temperature=fields.value(
            "ambient.temperature", table.ambient.temperature, TEMPERATURE
        ),
        initial_temperature=fields.value(
            "initial.temperature", table.initial.temperature, TEMPERATURE
        ),
        parameters=parameters,
        parameter_sets=sets,
        source=source,
    )
    fields.check_all_used()
    _check_grounded(rig, fields)
    return rig


def _check_grounded(rig: Rig, fields: Fields) -> None:
    # A part of the plate without any way to the surroundings has no steady state. With a film
    # coefficient each element has one, and so has each cell, through its sink.
    if rig.circuit is None:
        return
    neighbours: dict[str, set[str]] = {name: set() for name in (*rig.plate.element_names, AMBIENT)}
    pairs = [pair for link in rig.circuit.links for pair in link.between]
    pairs += [(element, AMBIENT) for cell in rig.cells for element, _ in cell.contacts]
    for first, second in pairs:
        neighbours[first].add(second)
        neighbours[second].add(first)
    reached, waiting = {AMBIENT}, [AMBIENT]
    while waiting:
        new = neighbours[waiting.pop()] - reached
        reached |= new
        waiting += new
    for element in rig.plate.element_names:
        if element not in reached:
            fields.refuse(
                "circuit.links",
                f"{element} has no path to {AMBIENT!r}, allowed are elements with at least one",
            )
