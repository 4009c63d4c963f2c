"""The reference of rig files: every key with its type, unit, default and range.

Types, defaults and numbers come from the schema. The unit of a quantity is known where the file is
read, so three small files that hold every quantity are read, and what each was taken for is noted.
"""

import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args
from unittest.mock import patch

from pymdownx.slugs import slugify

from jaxtwin import load_rig
from jaxtwin.rig import _schema as schema
from jaxtwin.rig._fields import Fields
from jaxtwin.rig._units import Kind

PEOPLE = Path(__file__).parents[1] / "rig-files.md"

ABOUT = """\
This page is generated from the schema by which rig files are read. [Rig files](../rig-files.md)
says what each key is, with an example.

A *quantity* is a number with a unit, or the name of a parameter; a *size* is a number with a unit.
Either may be in any unit that converts to the one in the table. A key without a default must be
given; *none* means that it may be left out.""".splitlines()

GEOMETRY = """
format = 1
name = "geometry"
parameters = {}
[plate]
columns = ["4 cm", "4 cm"]
rows = ["4 cm"]
thickness = "1 mm"
density = "8960 kg/m^3"
specific_heat = "390 J/(kg K)"
conductivity = "401 W/(m K)"
film_coefficient = ["15 W/(m^2 K)", "15 W/(m^2 K)"]
film_row_factor = ["1"]
film_exponent = "0.25"
emissivity = "0.1"
[[cells]]
name = "P1"
seebeck_coefficient = "0.05 V/K"
electrical_resistance = "2 ohm"
thermal_resistance = "1.9 K/W"
side_mass = "13 g"
side_specific_heat = "1200 J/(kg K)"
contacts = { V11 = "0.6 K/W" }
area = "16 cm^2"
sink_resistance = "0.5 K/W"
sink_capacitance = "200 J/K"
sink_air_resistance = "0.3 K/W"
fan = { speed = "1" }
initial_temperature = "20 degC"
full_scale = "12 V"
sink_initial_temperature = "20 degC"
[driver]
supply_voltage = "12 V"
supply_resistance = "0.2 ohm"
on_resistance = "0.1 ohm"
current_limit = "4 A"
lag = "5 s"
delay = "2 s"
counts = 255
polarity = 1
averaging = "on-off"
[camera]
resolution = [80, 60]
noise = "0.1 K"
view = { x = [0, 80], y = [10, 50] }
[camera.common_error]
offset = "0.5 K"
drift = "0.1 K"
drift_time = "100 s"
jump = "1 K"
relaxation = ["25 s"]
interval = "163 s"
[camera.registration]
[[channels]]
name = "T1"
x = ["0 cm", "4 cm"]
y = ["0 cm", "4 cm"]
[limits]
temperature = "80 degC"
cell_temperature = "130 degC"
lowest = "0 degC"
rate = "5 K/s"
frozen = "10 s"
deviation = "10 K"
command_delay = "1 s"
stop_on_alarm = true
[ambient]
temperature = "20 degC"
drift = "0.5 K/hour"
[initial]
temperature = "20 degC"
"""

CIRCUIT = """
format = 1
name = "circuit"
parameters = {}
[plate]
columns = ["4 cm"]
rows = ["4 cm"]
thickness = "1 mm"
[circuit]
capacitance = "28 J/K"
links = [{ resistance = "4 K/W", between = ["V11-ambient"] }]
[[cells]]
name = "P1"
module = "TEC1-12706"
side_capacitance = "17 J/K"
contacts = { V11 = "0.6 K/W" }
sink_resistance = "0.5 K/W"
sink = "block"
[[bodies]]
name = "block"
capacitance = "100 J/K"
initial_temperature = "20 degC"
[[bodies]]
name = "water"
temperature = "15 degC"
[[links]]
resistance = "0.1 K/W"
between = ["block-water"]
fan = { speed = "1" }
[driver]
supply_voltage = "12 V"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "voltage"
[sensors]
noise = "0.1 K"
[[channels]]
name = "T1"
x = "1 cm"
y = "1 cm"
lag = "5 s"
[ambient]
temperature = "20 degC"
[initial]
temperature = "20 degC"
"""

HEATERS = """
format = 1
name = "heaters"
parameters = {}
sensors = { noise = "0.1 K" }
ambient = { temperature = "20 degC" }
initial = { nodes = { air = "20 degC" } }
channels = [{ name = "T1", nodes = ["air"] }]
driver = { supply_voltage = "12 V" }
bodies = [{ name = "air", capacitance = "100 J/K" }]
[[links]]
between = ["air-ambient"]
resistance = "2 K/W"
convection = "0.1 W/K"
convection_exponent = "0.25"
radiating_area = "100 cm^2"
emissivity = "0.8"
[[heaters]]
name = "H1"
power = "10 W"
capacitance = "5 J/K"
drive = "1.6"
full_scale = "12 V"
contacts = { air = "1 K/W" }
initial_temperature = "20 degC"
[[heaters]]
name = "H2"
electrical_resistance = "4 ohm"
contacts = ["air"]
time_proportional = { period = "20 s", minimum_on = "2 s", minimum_off = "2 s" }
"""


PLACED = """
format = 1
name = "placed"
parameters = {}
ambient = { temperature = "20 degC" }
sensors = { noise = "0.1 K" }
channels = [{ name = "T1", x = ["0 cm", "4 cm"], y = ["0 cm", "4 cm"] }]
[driver]
supply_voltage = "12 V"
supply_resistance = "0.2 ohm"
on_resistance = "0.1 ohm"
counts = 255
polarity = 1
averaging = "on-off"
[plate]
width = "16 cm"
height = "8 cm"
resolution = "2 cm"
thickness = "1 mm"
density = "8960 kg/m^3"
specific_heat = "390 J/(kg K)"
conductivity = "401 W/(m K)"
film_coefficient = "15 W/(m^2 K)"
film_exponent = "0.25"
emissivity = "0.1"
[[heaters]]
name = "H1"
power = "10 W"
capacitance = "5 J/K"
at = ["4 cm", "4 cm"]
size = "4 cm"
angle = "30 deg"
contact_resistance = "0.5 K/W"
[[cells]]
name = "P1"
module = "TEC1-12706"
at = ["12 cm", "4 cm"]
size = "4 cm"
angle = "30 deg"
contact_resistance = "0.5 K/W"
side_capacitance = "17 J/K"
sink_resistance = "0.5 K/W"
"""


def write(page: Path) -> None:
    """Writes the page."""
    taken_for = kinds()
    lines = ["# Rig file, all keys", "", *ABOUT]
    for heading, model in tables():
        lines += [
            "",
            f"## `{heading}`",
            "",
            f"[What each key is](../rig-files.md#{_anchor(heading)}).",
        ]
        lines += ["", "| key | type | unit | range | default |", "|---|---|---|---|---|"]
        for key, field in model.model_fields.items():
            cells = _row(model, key, taken_for)
            default = _default(field)
            lines.append(f"| `{key}` | " + " | ".join((*cells, default)) + " |")
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


def tables() -> Iterator[tuple[str, type[schema.SchemaTable]]]:
    """Every table of a rig file with its heading, in the order of the schema."""
    yield "top level", schema.RigTable
    found = set()
    for heading, table in _inside(schema.RigTable, ""):
        if table not in found:  # links have fans as cells do
            yield heading, table
        found.add(table)


def kinds() -> dict[str, tuple[str, Kind]]:
    """Path of a key -> whether it is a quantity or a size, and what it measures."""
    found: dict[str, tuple[str, Kind]] = {}

    def noting(what: str, original: Any) -> Any:
        def read(fields: Fields, field: str, text: str, kind: Kind) -> Any:
            path = re.sub(r"\[[^]]*\]", "", field)
            path = re.sub(r"(contacts|initial\.nodes)\.\w+", r"\1", path)
            found.setdefault(path, (what, kind))
            return original(fields, field, text, kind)

        return read

    with (
        tempfile.TemporaryDirectory() as folder,
        patch.object(Fields, "value", noting("quantity", Fields.value)),
        patch.object(Fields, "constant", noting("size", Fields.constant)),
    ):
        texts = {"geometry": GEOMETRY, "circuit": CIRCUIT, "heaters": HEATERS, "placed": PLACED}
        for name, text in texts.items():
            file = Path(folder) / f"{name}.toml"
            file.write_text(text, encoding="utf-8")
            load_rig(file)
    return found


def _inside(
    model: type[schema.SchemaTable], path: str
) -> Iterator[tuple[str, type[schema.SchemaTable]]]:
    for key, field in model.model_fields.items():
        inner = _table_in(field.annotation)
        if inner is None:
            continue
        name = f"{path}.{key}".lstrip(".")
        heading = f"[[{name}]]" if "list[" in str(field.annotation) else f"[{name}]"
        if inner is schema.PriorTable:
            heading = "prior"
        yield heading, inner
        yield from _inside(inner, name)


def _table_in(annotation: Any) -> type[schema.SchemaTable] | None:
    if isinstance(annotation, type) and issubclass(annotation, schema.SchemaTable):
        return annotation
    return next((t for part in get_args(annotation) if (t := _table_in(part))), None)


def _row(
    model: type[schema.SchemaTable], key: str, taken_for: Mapping[str, tuple[str, Kind]]
) -> tuple[str, str, str]:
    """Type, unit and range of a key."""
    annotation = model.model_fields[key].annotation
    if _table_in(annotation) is not None:
        return ("tables" if "list[" in str(annotation) else "table"), "", ""
    path = f"{_path(model)}.{key}".lstrip(".")
    if path not in taken_for:
        if _holds_a_quantity(model.model_fields[key]):
            raise KeyError(
                f"{path}: expected in GEOMETRY, CIRCUIT, HEATERS or PLACED, where its unit is noted"
            )
        described = model.model_json_schema()["properties"][key]
        return _plain_type(described), "", _range(described)
    what, kind = taken_for[path]
    if "dict[" in str(annotation):
        what = {"quantity": "table of quantities", "size": "table of sizes"}[what]
    elif key in ("x", "y"):
        what = f"{what}, or list of two"
    elif annotation is Any:
        what += _also(model.model_fields[key])
    elif "list[" in str(annotation):
        what = {"quantity": "list of quantities", "size": "list of sizes"}[what]
    least = {"positive": "> 0", "zero": "≥ 0", "any": ""}[kind.least]
    return what, kind.unit or "1", "> 0 K" if kind.absolute else least


def _also(field: Any) -> str:
    """What else than a quantity a key takes."""
    readers = {getattr(part, "func", None) for part in field.metadata}
    if schema._quantity_or_switch in readers:
        return ", or one for each state of an input"
    if schema._names_or_resistances in readers:
        return " for each node, or list of names"
    return ", or list"


def _holds_a_quantity(field: Any) -> bool:
    quantities = {
        schema._quantity,
        schema._quantity_or_list,
        schema._quantity_or_switch,
        schema._names_or_resistances,
        schema._place,
    }

    def found(metadata: Any, annotation: Any) -> bool:
        own = any(getattr(part, "func", None) in quantities for part in metadata)
        inner = (
            found(getattr(part, "__metadata__", ()), part)
            for part in get_args(annotation)
            if get_args(part) or hasattr(part, "__metadata__")
        )
        return own or any(inner)

    return found(field.metadata, field.annotation)


def _path(model: type[schema.SchemaTable]) -> str:
    heading = next(heading for heading, found in tables() if found is model)
    return "" if heading == "top level" else heading.strip("[]")


def _plain_type(described: dict[str, Any]) -> str:
    """A JSON schema in words."""
    if "anyOf" in described:
        return _plain_type(next(part for part in described["anyOf"] if part != {"type": "null"}))
    if "enum" in described or "const" in described:
        words = described.get("enum", [described.get("const")])
        return " or ".join(f"`{json.dumps(word)}`" for word in words)
    kind = described.get("type", "")
    if kind == "array":
        return "list of " + {"string": "texts"}.get(described["items"]["type"], "numbers")
    names = {"string": "text", "integer": "whole number", "number": "number", "boolean": "boolean"}
    return names.get(kind, "table")


def _range(described: dict[str, Any]) -> str:
    parts = [described, *described.get("anyOf", []), described.get("items", {})]
    words = []
    for part in parts:
        signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
        words += [f"{sign} {part[key]:.10g}" for key, sign in signs.items() if key in part]
        least, most = part.get("minItems"), part.get("maxItems")
        if least is not None:
            words.append(f"{least} entries" if least == most else f"{least} or more entries")
    return ", ".join(words)


def _default(field: Any) -> str:
    if field.is_required():
        return ""
    return "*none*" if field.default is None else f"`{json.dumps(field.default)}`"


def _anchor(heading: str) -> str:
    """Of the section for people."""
    shown = {"top level": "`top level`", "prior": "`prior` of a parameter"}
    shown["[cells.fan]"] = "`fan` of a cell or a link"
    shown["[heaters.time_proportional]"] = "`time_proportional` of a heater"
    ending = shown.get(heading, f"`{heading}`")
    titles = re.findall(r"^## (.+)$", PEOPLE.read_text(encoding="utf-8"), re.MULTILINE)
    (title,) = [title for title in titles if title.endswith(ending)]
    return slugify(case="lower")(title.replace("`", ""), "-")
