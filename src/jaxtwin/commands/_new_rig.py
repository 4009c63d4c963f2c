"""`jaxtwin new-rig`: a first rig file, from a few questions."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .._name_suggestions import unknown_name
from .._whole_file import write_whole_file
from ..errors import JaxtwinError, RigError
from ._output import check_output, write_json

if TYPE_CHECKING:
    from ..rig import CellPlace, HeaterPlace, Rig

# The kind of a rig with a plate and cells.
PLATE = "plate"

NO_HEATERS = "none"

# Option, question and default of the answer; None if there is none.
Asked = tuple[str, str, str | None]


def new_rig(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The rig file to write, .toml.")],
    width: Annotated[
        str | None, typer.Option(metavar="SIZE", help='Of the plate, such as "8 cm".')
    ] = None,
    height: Annotated[str | None, typer.Option(metavar="SIZE", help="Of the plate.")] = None,
    thickness: Annotated[str | None, typer.Option(metavar="SIZE", help="Of the plate.")] = None,
    material: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of the plate, such as aluminium.")
    ] = None,
    module: Annotated[
        str | None, typer.Option(metavar="NAME", help="Datasheet of the cells: TEC1-12706.")
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y",
            help='Centre of a cell from the left and top edge: "2 cm, 2 cm"; for each cell.',
        ),
    ] = None,
    heater: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME,POWER,X,Y",
            help='A heater beside the cells: "foil, 10 W, 4 cm, 2 cm"; for each heater.',
        ),
    ] = None,
    zones: Annotated[
        str | None, typer.Option(metavar="CxR", help="Columns and rows of zones that are read.")
    ] = None,
    supply_voltage: Annotated[str, typer.Option(metavar="VOLTAGE", help="Of the driver.")] = "12 V",
    limit: Annotated[
        str, typer.Option(metavar="TEMPERATURE", help="Above it, driving stops.")
    ] = "80 degC",
    reader: Annotated[
        Literal["camera", "sensors"] | None,
        typer.Option(help="What reads the zones; camera if nobody can be asked."),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="plate, or a rig without one after which the file is written, such as heated-box.",
        ),
    ] = None,
    value: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=NUMBER", help="With such a kind: the value of a parameter."),
    ] = None,
) -> None:
    """Write a commented rig file. What no option gives is asked.

    Sizes are text with a unit. What is not known has a value from handbooks or a datasheet, and a
    prior as wide as the ignorance. Beside it is rig.schema.json, with which editors complete and
    check the file. A file that is there is not replaced.
    """
    check_output(file, ".toml", option="FILE")
    if file.exists():
        raise RigError(f"{file}: expected a new file, got one that is there; choose another name")
    from ..rig import (
        TEMPERATURE,
        VOLTAGE,
        Fields,
        bundled_materials,
        bundled_modules,
        check_zones,
        covered_elements,
        divided_plate,
        example_rig_text,
        heated_elements,
        load_module,
        misfit,
        new_rig_text,
        plate_size,
    )

    fields = Fields("new rig", {}, {})
    fields.constant("supply_voltage", supply_voltage, VOLTAGE)
    fields.constant("limit", limit, TEMPERATURE)

    on_plate = [width, height, thickness, material, module, at, heater, zones, reader]
    kind = _kind(kind, any(option is not None for option in on_plate))
    if kind != PLATE:
        _write(file, example_rig_text(file.stem, kind, _values(kind, value)))
        return
    if value:
        raise typer.BadParameter(
            "--value: expected none for a plate; edit the file that is written"
        )

    def size(argument: str) -> Callable[[str], object]:
        return lambda text: plate_size(fields, argument, text)

    def one_of(argument: str, known: list[str]) -> Callable[[str], object]:
        return lambda text: fields.check_known(argument, argument, text, known)

    materials, modules = bundled_materials(), bundled_modules()
    width = _answer(width, ("--width", "width of the plate", "8 cm"), size("width"))
    height = _answer(height, ("--height", "height of the plate", "4 cm"), size("height"))
    thickness = _answer(
        thickness, ("--thickness", "thickness of the plate", "2 mm"), size("thickness")
    )
    material = _answer(
        material,
        ("--material", f"material ({', '.join(materials)})", "aluminium"),
        one_of("material", list(materials)),
    )
    module = _answer(
        module,
        ("--module", f"module ({', '.join(modules)})", "TEC1-12706"),
        one_of("module", list(modules)),
    )
    sheet = load_module(module)
    sizes = {"width": width, "height": height, "thickness": thickness}
    plate = divided_plate(**{name: plate_size(fields, name, text) for name, text in sizes.items()})
    asked = "centres of the cells from the left and the top edge, such as 2 cm,2 cm; 6 cm,2 cm"
    centres = _answer(
        "; ".join(at) if at else None,
        ("--at", asked, None),
        lambda text: covered_elements(fields, _places(text), sheet, plate),
    )
    heaters = _answer(
        "; ".join(heater) if heater else None if sys.stdin.isatty() else NO_HEATERS,
        ("--heater", "heaters beside them, such as foil,10 W,4 cm,2 cm", NO_HEATERS),
        lambda text: heated_elements(fields, _heaters(text), plate, len(_places(centres))),
    )
    zones = _answer(
        zones,
        ("--zones", "columns x rows of zones that are read", "3x2"),
        lambda text: check_zones(fields, _zones(text)),
    )
    if reader is None:
        reader = _reader()
    text = new_rig_text(
        file.stem,
        width=width,
        height=height,
        thickness=thickness,
        material=material,
        module=module,
        places=_places(centres),
        heaters=_heaters(heaters),
        zones=_zones(zones),
        supply_voltage=supply_voltage,
        limit=limit,
        reader=reader,
    )
    rig = _write(file, text)
    for cell in rig.cells:
        note = misfit(rig.plate, [element for element, _ in cell.contacts], sheet)
        if note:
            print(f"{cell.name}: {note}")


def _write(file: Path, text: str) -> "Rig":
    """Writes the rig file, and beside it the schema; shows the rig that it describes."""
    from ..rig import json_schema, load_rig

    # Editors with Even Better TOML or Taplo read the schema's place from the first line.
    schema = file.with_name("rig.schema.json")
    write_whole_file(file, f"#:schema ./{schema.name}\n{text}".encode(), RigError)
    if not schema.exists():
        write_json(schema, json_schema())
    rig = load_rig(str(file))
    print(rig)
    print(f"written to {file}; check it after a change: jaxtwin check {file}")
    return rig


def _kind(given: str | None, is_plate: bool) -> str:
    """The kind of rig: a plate if one of its options is given, or if nobody can be asked."""
    if given == PLATE or (given is None and (is_plate or not sys.stdin.isatty())):
        return PLATE
    from ..rig import example_rigs

    known = [PLATE, *example_rigs()]

    def check(text: str) -> None:
        if text not in known:
            raise typer.BadParameter(f"--kind: {unknown_name('kind', text, known)}")

    return _answer(given, ("--kind", f"kind of rig ({', '.join(known)})", PLATE), check)


def _values(example: str, given: list[str] | None) -> dict[str, float]:
    """The values of an example's parameters: those of the options, and the answers of a person,
    who is asked for each that is not of a single recording."""
    from ..rig import Fields, check_value, load_rig

    rig, fields = load_rig(example), Fields("new rig", {}, {})
    values = {}
    for text in given or []:
        name, number = _pair("--value", text, "=", '"P=40"')
        values[name] = _number(name, number)
        check_value(rig, name, values[name], fields)
    if given or not sys.stdin.isatty():
        return values
    for row in rig.parameters.values():
        if row.scope != "recording":
            question = f"{row.name}, {row.description}, {row.unit}"
            answer = _answer(
                None,
                ("--value", question, f"{row.value:g}"),
                lambda text, name=row.name: check_value(rig, name, _number(name, text), fields),
            )
            values[row.name] = _number(row.name, answer)
    return values


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"--value: {name}: expected a number, got {text!r}") from None


def _answer(given: str | None, asked: Asked, check: Callable[[str], object]) -> str:
    """The value of an option, or the answer of a person, who is asked again after a wrong answer.

    **Arguments:**

    - `given`: the value of the option, which is checked before anything more is asked.
    - `check`: a function that raises an error for a wrong answer.

    **Raises:** a `typer.BadParameter` that names the option if nobody can be asked.
    """
    option, question, default = asked
    if given is not None:
        check(given)
        return given
    if not sys.stdin.isatty():
        raise typer.BadParameter(f"{option}: expected a value, as there is nobody to ask, got none")
    while True:
        answer = typer.prompt(question, default=default)
        try:
            check(answer)
        except (JaxtwinError, typer.BadParameter) as error:
            typer.echo(str(error), err=True)
            continue
        return answer


def _reader() -> Literal["camera", "sensors"]:
    if not sys.stdin.isatty():
        return "camera"
    question = "what reads the zones: camera, or sensors such as thermocouples"
    return (
        "sensors"
        if _answer(None, ("--reader", question, "camera"), _is_reader) == "sensors"
        else "camera"
    )


def _is_reader(text: str) -> None:
    if text not in ("camera", "sensors"):
        raise typer.BadParameter(f"--reader: expected camera or sensors, got {text!r}")


def _places(text: str) -> list["CellPlace"]:
    from ..rig import CellPlace

    parts = [part for part in text.split(";") if part.strip()]
    return [CellPlace(*_pair("--at", part, ",", '"2 cm, 2 cm"')) for part in parts]


def _heaters(text: str) -> list["HeaterPlace"]:
    from ..rig import HeaterPlace

    if text.strip() in ("", NO_HEATERS):
        return []
    heaters = []
    for part in text.split(";"):
        words = [word.strip() for word in part.split(",")]
        if len(words) != 4 or not all(words):
            raise typer.BadParameter(
                f'--heater: expected such as "foil, 10 W, 4 cm, 2 cm", got {part.strip()!r}'
            )
        heaters.append(HeaterPlace(*words))
    return heaters


def _pair(option: str, text: str, separator: str, example: str) -> tuple[str, str]:
    parts = [part.strip() for part in text.split(separator)]
    if len(parts) != 2 or not all(parts):
        raise typer.BadParameter(f"{option}: expected such as {example}, got {text!r}")
    return parts[0], parts[1]


def _zones(text: str) -> tuple[int, int]:
    columns, rows = _pair("--zones", text.lower(), "x", "3x2")
    try:
        return int(columns), int(rows)
    except ValueError:
        raise typer.BadParameter(f"--zones: expected such as 3x2, got {text!r}") from None
