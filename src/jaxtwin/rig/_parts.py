"""Tables of a rig file -> the parts of a rig."""

from itertools import pairwise
from typing import Any

from . import _schema as schema
from . import _units as units
from ._bundled import bundled_modules
from ._camera import Camera, Channel
from ._cell import Cell
from ._circuit import Circuit, CircuitLink
from ._datasheet import load_module
from ._driver import Driver
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._problems import unknown
from ._value import Value

_MATERIAL = ("density", "specific_heat", "conductivity", "film_coefficient")
_ROUNDING = 1e-9  # of the plate's size: sums of element sizes need not meet its edge exactly


def build_plate(table: schema.PlateTable, has_circuit: bool, fields: Fields) -> Plate:
    """The plate; with its material where the file gives no circuit."""
    columns, rows = (
        tuple(
            fields.constant(f"plate.{name}[{index}]", text, units.LENGTH)
            for index, text in enumerate(getattr(table, name), 1)
        )
        for name in ("columns", "rows")
    )
    thickness = fields.value("plate.thickness", table.thickness, units.LENGTH)
    given = [name for name in (*_MATERIAL, "film_row_factor") if getattr(table, name) is not None]
    if has_circuit:
        if given:
            fields.refuse(
                f"plate.{given[0]}", "found beside [circuit], allowed is only one of the two"
            )
        return Plate(columns, rows, thickness)
    for name in _MATERIAL:
        if name not in given:
            fields.refuse(
                f"plate.{name}",
                f"missing, allowed is [circuit] or all of plate.{', plate.'.join(_MATERIAL)}",
            )
    return Plate(
        columns,
        rows,
        thickness,
        density=fields.value("plate.density", str(table.density), units.DENSITY),
        specific_heat=fields.value(
            "plate.specific_heat", str(table.specific_heat), units.SPECIFIC_HEAT
        ),
        conductivity=fields.value(
            "plate.conductivity", str(table.conductivity), units.CONDUCTIVITY
        ),
        film_coefficient=_each(
            "plate.film_coefficient",
            table.film_coefficient,
            len(columns),
            "column",
            units.FILM_COEFFICIENT,
            fields,
        ),
        film_row_factor=_each(
            "plate.film_row_factor",
            table.film_row_factor or "1",
            len(rows),
            "row",
            units.FACTOR,
            fields,
        ),
    )


def build_circuit(table: schema.CircuitTable, plate: Plate, fields: Fields) -> Circuit:
    """The circuit that a file gives link by link."""
    nodes = (*plate.element_names, AMBIENT)
    links = []
    for link in table.links:
        field = f"circuit.links[{link.resistance}]"
        resistance = fields.value(f"{field}.resistance", link.resistance, units.THERMAL_RESISTANCE)
        pairs = tuple(_link_ends(f"{field}.between", text, nodes, fields) for text in link.between)
        links.append(CircuitLink(resistance, link.factor, pairs))
    capacitance = fields.value("circuit.capacitance", table.capacitance, units.HEAT_CAPACITY)
    return Circuit(capacitance, tuple(links))


def build_cell(table: schema.CellTable, plate: Plate, fields: Fields) -> Cell:
    """A cell; constants that the file does not give come from the datasheet of its module."""
    at = f"cells[{table.name}]"

    def value(name: str, kind: units.Kind) -> Value | None:
        text = getattr(table, name)
        return None if text is None else fields.value(f"{at}.{name}", text, kind)

    def constant(name: str, kind: units.Kind) -> Value:
        given = value(name, kind)
        if given is not None:
            return given
        if table.module is None:
            fields.refuse(f"{at}.{name}", "missing, allowed is a value or the name of a module")
        return Value(getattr(load_module(table.module), name))

    if table.module is not None and table.module not in bundled_modules():
        fields.refuse(f"{at}.module", unknown("module", table.module, bundled_modules()))
    contacts = []
    for element, text in table.contacts.items():
        field = f"{at}.contacts.{element}"
        _check_element(field, element, plate.element_names, fields)
        contacts.append((element, fields.value(field, text, units.THERMAL_RESISTANCE)))
    sink_capacitance = value("sink_capacitance", units.HEAT_CAPACITY)
    sink_air_resistance = value("sink_air_resistance", units.THERMAL_RESISTANCE)
    if (sink_capacitance is None) != (sink_air_resistance is None):
        fields.refuse(at, "allowed is both or neither of sink_capacitance and sink_air_resistance")
    return Cell(
        name=table.name,
        seebeck_coefficient=constant("seebeck_coefficient", units.SEEBECK_COEFFICIENT),
        electrical_resistance=constant("electrical_resistance", units.ELECTRICAL_RESISTANCE),
        thermal_resistance=constant("thermal_resistance", units.THERMAL_RESISTANCE),
        side_capacitance=_side_capacitance(at, table, fields),
        contacts=tuple(contacts),
        sink_resistance=fields.value(
            f"{at}.sink_resistance", table.sink_resistance, units.THERMAL_RESISTANCE
        ),
        sink_capacitance=sink_capacitance,
        sink_air_resistance=sink_air_resistance,
        initial_temperature=value("initial_temperature", units.TEMPERATURE),
    )


def build_driver(table: schema.DriverTable, fields: Fields) -> Driver:
    """The driver."""
    if table.averaging == "voltage" and table.off_phase != "brake":
        fields.refuse(
            "driver.off_phase",
            f'found {table.off_phase!r}, allowed with averaging = "voltage" is "brake"',
        )
    return Driver(
        supply_voltage=fields.value("driver.supply_voltage", table.supply_voltage, units.VOLTAGE),
        supply_resistance=fields.value(
            "driver.supply_resistance", table.supply_resistance, units.SERIES_RESISTANCE
        ),
        on_resistance=fields.value(
            "driver.on_resistance", table.on_resistance, units.SERIES_RESISTANCE
        ),
        counts=table.counts,
        polarity=table.polarity,
        averaging=table.averaging,
        off_phase=table.off_phase,
    )


def build_camera(table: schema.CameraTable, fields: Fields) -> Camera:
    """The camera."""
    width, height = table.resolution
    for axis, size in (("x", width), ("y", height)):
        first, last = getattr(table.view, axis)
        if not 0 <= first < last <= size:
            fields.refuse(
                f"camera.view.{axis}",
                f"found [{first:g}, {last:g}], allowed is a range of pixels in 0 to {size}",
            )
    return Camera(
        width=width,
        height=height,
        noise=fields.constant("camera.noise", table.noise, units.NOISE),
        view_x=(table.view.x[0], table.view.x[1]),
        view_y=(table.view.y[0], table.view.y[1]),
    )


def build_channel(table: schema.ChannelTable, plate: Plate, fields: Fields) -> Channel:
    """A channel, over named elements or over a rectangle of the plate."""
    at = f"channels[{table.name}]"
    gain = fields.value(f"{at}.gain", table.gain, units.FACTOR)
    if table.nodes is not None:
        if table.x is not None or table.y is not None:
            fields.refuse(at, "allowed is nodes or x and y, not both")
        for index, node in enumerate(table.nodes, 1):
            _check_element(f"{at}.nodes[{index}]", node, plate.element_names, fields)
        check_unique(f"{at}.nodes", table.nodes, fields)
        return Channel(table.name, tuple(table.nodes), None, None, gain)
    if table.x is None or table.y is None:
        fields.refuse(at, "allowed is nodes, or both x and y")
    return Channel(
        table.name,
        (),
        _range(f"{at}.x", table.x, plate.width, fields),
        _range(f"{at}.y", table.y, plate.height, fields),
        gain,
    )


def check_unique(field: str, names: Any, fields: Fields) -> None:
    """Refuses a name that stands twice."""
    for first, second in pairwise(sorted(names)):
        if first == second:
            fields.refuse(field, f"found {first!r} twice, allowed is each name once")


def _each(
    field: str, given: Any, count: int, of: str, kind: units.Kind, fields: Fields
) -> tuple[Value, ...]:
    if isinstance(given, str):
        return (fields.value(field, given, kind),) * count
    if len(given) != count:
        fields.refuse(field, f"found {len(given)} values, allowed is one for each {of}: {count}")
    return tuple(fields.value(f"{field}[{i}]", text, kind) for i, text in enumerate(given, 1))


def _link_ends(field: str, text: str, nodes: tuple[str, ...], fields: Fields) -> tuple[str, str]:
    ends = tuple(end.strip() for end in text.split("-"))
    if len(ends) != 2:
        fields.refuse(field, f'found {text!r}, allowed is two nodes such as "V11-V12"')
    for end in ends:
        _check_element(field, end, nodes, fields)
    if ends[0] == ends[1]:
        fields.refuse(field, f"found {text!r}, allowed are links between two different nodes")
    return ends[0], ends[1]


def _check_element(field: str, name: str, known: tuple[str, ...], fields: Fields) -> None:
    if name not in known:
        fields.refuse(field, unknown("plate element", name, known))


def _side_capacitance(at: str, table: schema.CellTable, fields: Fields) -> Value:
    pair = (table.side_mass, table.side_specific_heat)
    if table.side_capacitance is not None and pair == (None, None):
        return fields.value(f"{at}.side_capacitance", table.side_capacitance, units.HEAT_CAPACITY)
    if table.side_capacitance is not None or None in pair:
        fields.refuse(
            at, "allowed is side_capacitance, or side_mass and side_specific_heat, not both"
        )
    return fields.value(f"{at}.side_mass", str(pair[0]), units.MASS) * fields.value(
        f"{at}.side_specific_heat", str(pair[1]), units.SPECIFIC_HEAT
    )


def _range(field: str, texts: list[str], size: float, fields: Fields) -> tuple[float, float]:
    first, last = (fields.constant(field, text, units.COORDINATE) for text in texts)
    if not first < last <= size * (1 + _ROUNDING):
        fields.refuse(
            field,
            f"found {texts}, allowed is a range inside the plate, 0 to {100 * size:g} cm",
        )
    return first, min(last, size)
