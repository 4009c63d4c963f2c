"""Whatever sizes a person gives, the written rig file is read and has a network."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import typer
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from jaxtwin import load_rig
from jaxtwin.cli import run
from jaxtwin.errors import RigError
from jaxtwin.physics import build_netlist
from jaxtwin.rig import (
    CellPlace,
    HeaterPlace,
    bundled_materials,
    bundled_modules,
    load_module,
    new_rig_text,
)
from jaxtwin.rig._new_rig import example_rigs

PLAIN: dict[str, Any] = {
    "width": "8 cm",
    "height": "4 cm",
    "thickness": "2 mm",
    "material": "aluminium",
    "module": "TEC1-12706",
    "places": [CellPlace("2 cm", "2 cm"), CellPlace("6 cm", "2 cm")],
}

ARGUMENTS = [
    "--width", "8 cm", "--height", "4 cm", "--thickness", "2 mm", "--material", "copper",
    "--module", "CP10-127-05", "--at", "2 cm, 2 cm", "--at", "6 cm,2 cm", "--zones", "4x2",
]  # fmt: skip


def read(text: str, folder: Path):
    path = folder / "made.toml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


def test_cells_touch_the_elements_under_them(tmp_path: Path):
    """40 mm wide modules, side by side on 8 cm x 4 cm: each covers half of the plate. The contacts
    of its 16 elements of 1 cm^2 are those of a layer of grease of 0.5 cm^2 K/W."""
    rig = read(new_rig_text("bench", **PLAIN), tmp_path)
    assert [len(cell.contacts) for cell in rig.cells] == [16, 16]
    assert {name for name, _ in rig.cells[0].contacts} == {
        f"V{row}{column}" for row in (1, 2, 3, 4) for column in (1, 2, 3, 4)
    }
    assert rig.parameters["R_pc_1"].value == pytest.approx(0.5)
    # They cover one of the two faces: the upper one and the rim lose heat.
    values = {name: row.value for name, row in rig.parameters.items()}
    lost = build_netlist(rig).ambient_conductance(values, "plate")
    assert lost == pytest.approx(15.0 * (0.08 * 0.04 + 2 * 0.12 * 0.002), rel=0.01)
    sheet = load_module("TEC1-12706")
    assert rig.parameters["R_E"].value == pytest.approx(sheet.electrical_resistance, rel=1e-3)
    assert [channel.name for channel in rig.channels] == ["T11", "T12", "T13", "T21", "T22", "T23"]


FOIL = HeaterPlace("foil", "10 W", "1.5 cm", "0 cm")
BULB = HeaterPlace("bulb_2", "2.5 kW", "8 cm", "4 cm")


def test_heaters_stand_beside_the_cells(tmp_path: Path):
    """The heat goes into the element under the place; limits are those of a heater."""
    rig = read(new_rig_text("bench", **PLAIN, heaters=[FOIL, BULB]), tmp_path)
    assert rig.driven == ("P1", "P2", "foil", "bulb_2")
    assert [heater.node for heater in rig.heaters] == ["V12", "V48"]
    assert rig.lowest_duty == (-1, -1, 0, 0)
    assert rig.parameters["P_foil"].value == 10
    assert rig.parameters["P_bulb_2"].value == 2500
    assert rig.title.endswith("2 x TEC1-12706, foil, bulb_2")


@pytest.mark.parametrize(
    ("heater", "message"),
    [
        (FOIL._replace(name="P1"), "heater 1: name: expected a name of its own, got 'P1'"),
        (FOIL._replace(name="V12"), "heater 1: name: expected a name of its own"),
        (FOIL._replace(name="my foil"), "name: expected letters, digits and _, got 'my foil'"),
        (FOIL._replace(power="10 K"), "heater 1: power: expected a power above 0 such as"),
        (FOIL._replace(power="-3 W"), "heater 1: power: expected"),
        (FOIL._replace(x="9 cm"), "heater 1: x: expected a place on the plate, 0 to 8 cm, got"),
    ],
)
def test_heaters_that_cannot_be_are_refused(heater: HeaterPlace, message: str):
    with pytest.raises(RigError, match=message):
        new_rig_text("bench", **PLAIN, heaters=[heater])
    with pytest.raises(RigError, match="heater 2: name: expected a name of its own, got 'foil'"):
        new_rig_text("bench", **PLAIN, heaters=[FOIL, FOIL])


LENGTHS = st.floats(0.002, 0.12)


@settings(max_examples=10, phases=[Phase.generate])
@given(
    width=LENGTHS,
    height=LENGTHS,
    thickness=st.floats(1e-4, 0.05),
    material=st.sampled_from(bundled_materials()),
    module=st.sampled_from(bundled_modules()),
    place=st.tuples(st.integers(0, 100), st.integers(0, 100)),
    zones=st.tuples(st.integers(1, 11), st.integers(1, 4)),
    reader=st.sampled_from(["camera", "sensors"]),
    name=st.text("aZ9ß°\"'\\#{}[]=", min_size=1, max_size=8),
)
def test_any_sizes_give_a_rig(
    width, height, thickness, material, module, place, zones, reader, name, tmp_path_factory
):
    text = new_rig_text(
        name,
        width=f"{width} m",
        height=f"{1e3 * height} mm",
        thickness=f"{1e2 * thickness} cm",
        material=material,
        module=module,
        places=[CellPlace(f"{place[0] * width} cm", f"{place[1] * height} cm")],
        zones=zones,
        reader=reader,
    )
    rig = read(text, tmp_path_factory.mktemp("made"))
    assert rig.name == name
    assert rig.plate.width == pytest.approx(width, rel=1e-5)
    assert rig.plate.height == pytest.approx(height, rel=1e-5)
    assert len(rig.channels) == zones[0] * zones[1]
    assert build_netlist(rig).cells
    assert all(row.free for row in rig.parameters.values())


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"width": "8"}, "width: expected a length above 0 such as"),
        ({"width": "8 kg"}, "width: expected a length"),
        ({"height": "0.1 mm"}, "height: expected 1 mm to 10 m"),
        ({"thickness": "-1 mm"}, "thickness: expected a length above 0"),
        ({"material": "coper"}, "did you mean 'copper'"),
        ({"module": "TEC1-1270"}, "did you mean 'TEC1-127"),
        ({"places": []}, "places: expected 1 to 100 cells, got 0"),
        ({"places": [CellPlace("9 cm", "2 cm")]}, "cell 1: x: expected a place on the plate"),
        (
            {"places": [CellPlace("2 cm", "2 cm"), CellPlace("5 cm", "2 cm")]},
            "cell 2: expected cells beside each other, got cells 1 and 2 both on",
        ),
        ({"zones": (0, 2)}, "zones: expected 1 to 100 columns, got 0"),
        ({"supply_voltage": "12 A"}, "supply_voltage: expected a voltage"),
        ({"limit": "80 K/W"}, "limit: expected a temperature"),
    ],
)
def test_what_does_not_fit_is_named(changed: dict[str, Any], message: str):
    with pytest.raises(RigError, match=message) as caught:
        new_rig_text("bench", **PLAIN | changed)
    assert "\n" not in str(caught.value)


def test_a_name_of_two_lines_is_refused():
    with pytest.raises(RigError, match="name: expected text on one line"):
        new_rig_text("a\nb", **PLAIN)


def test_the_command_writes_a_file_that_check_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    assert run(["new-rig", "bench.toml", *ARGUMENTS]) == 0
    assert "P2 on" in capsys.readouterr().out
    assert run(["check", "bench.toml"]) == 0
    made = tomllib.loads(Path("bench.toml").read_text("utf-8"))
    assert made["name"] == "bench"
    assert len(made["channels"]) == 8
    before = Path("bench.toml").read_bytes()
    assert run(["new-rig", "bench.toml", *ARGUMENTS]) == 2
    assert "expected a new file" in capsys.readouterr().err
    assert Path("bench.toml").read_bytes() == before


def test_an_editor_finds_the_schema_from_the_first_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert run(["new-rig", "bench.toml", *ARGUMENTS]) == 0
    directive, _, text = Path("bench.toml").read_text("utf-8").partition("\n")
    assert directive.startswith("#:schema ./")
    schema = Path(directive.removeprefix("#:schema "))
    validator = jsonschema.Draft202012Validator(json.loads(schema.read_text("utf-8")))
    validator.validate(tomllib.loads(text))
    with pytest.raises(jsonschema.ValidationError, match="thicknes"):
        validator.validate(tomllib.loads(text.replace("thickness", "thicknes")))
    schema.write_text("{}")
    assert run(["new-rig", "other.toml", *ARGUMENTS]) == 0
    assert schema.read_text("utf-8") == "{}"


def test_a_person_is_asked_for_what_no_option_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    centres = ["2 cm,2 cm; 4 cm,2 cm", "1.5 cm,2 cm; 9 cm,2 cm", "1.5 cm,2 cm; 4.5 cm,2 cm"]
    answers = {
        "width of": ["6 cm"],
        "centres": centres,
        "module": ["CP10-127-05"],
        "heaters": ["foil, 10 W, 3 cm", "foil, 10 W, 3 cm, 2 cm; bulb, 40 W, 5 cm, 1 cm"],
        "what reads": ["thermometer", "sensors"],
    }
    asked = []

    def prompt(question: str, default: str | None) -> str | None:
        asked.append(question)
        given = [answer for start, answer in answers.items() if question.startswith(start)]
        return given[0].pop(0) if given else default

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(typer, "prompt", prompt)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    assert run(["new-rig", "bench.toml", "--height", "4 cm"]) == 0
    both, beside, heater, reader = capsys.readouterr().err.splitlines()
    assert "cells 1 and 2 both on" in both  # the modules are 3 cm wide
    assert "cell 2: x: expected a place on the plate" in beside
    assert "--heater: expected such as" in heater
    assert "--reader: expected camera or sensors, got 'thermometer'" in reader
    assert sum(question.startswith("width") for question in asked) == 1
    assert not any(question.startswith("height") for question in asked)
    rig = load_rig("bench.toml")
    assert rig.plate.width == pytest.approx(0.06)
    assert rig.driven == ("P1", "P2", "foil", "bulb")
    assert rig.camera is None
    assert rig.sensors is not None


def test_a_module_between_the_edges_of_elements_is_named_in_the_file_and_by_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Modules of 40 mm at 2.5 and 7.5 cm leave a gap of 10 mm. Each touches five elements of 10 mm,
    half of the outer ones, so that there is none. All contacts together are that of its face."""
    monkeypatch.chdir(tmp_path)
    sizes = ["--width", "10 cm", "--height", "4 cm", "--thickness", "2 mm", "--zones", "2x1"]
    kinds = ["--material", "copper", "--module", "TEC1-12706"]
    places = ["--at", "2.5 cm, 2 cm", "--at", "7.5 cm, 2 cm"]
    assert run(["new-rig", "bench.toml", *sizes, *kinds, *places]) == 0
    note = "its face is 40 mm x 40 mm, but the elements that it touches are 50 mm x 40 mm"
    printed = capsys.readouterr().out
    written = Path("bench.toml").read_text("utf-8")
    for name in ("P1", "P2"):
        assert f"\n{name}: {note}" in printed
        assert f"\n# {name}: {note}" in written
    rig = load_rig("bench.toml")
    assert rig.parameters["R_pc_1"].value / len(rig.cells[0].contacts) == pytest.approx(
        0.5e-4 / 0.0016
    )
    assert run(["new-rig", "fits.toml", *sizes, *kinds, "--at", "2 cm, 2 cm"]) == 0
    assert note[:20] not in capsys.readouterr().out + Path("fits.toml").read_text("utf-8")


def test_all_answers_are_kept_from_a_wrong_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Options are checked before a person has answered for nothing."""
    asked = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(typer, "prompt", lambda question, default: asked.append(question))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    assert run(["new-rig", "bench.toml", "--limit", "80 K/W"]) == 2
    assert "limit: expected a temperature" in capsys.readouterr().err
    assert run(["new-rig", "bench.toml", "--width", "8"]) == 2
    assert "width: expected a length above 0" in capsys.readouterr().err
    assert asked == []


def test_a_wrong_answer_is_asked_for_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    answers = {
        "width": ["60", "4 parsec", "6 cm"],
        "material": ["aluminum", "aluminium"],
        "module": ["TEC12706", "TEC1-12706"],
        "centres": ["3 cm 2 cm", "3 cm, 2 cm"],
        "heaters": ["none"],
        "columns": ["3", "0x2", "3x2"],
        "what": ["camera"],
    }

    def prompt(question: str, default: str | None) -> str | None:
        return answers[question.split()[0]].pop(0)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(typer, "prompt", prompt)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    assert run(["new-rig", "bench.toml", "--height", "4 cm", "--thickness", "2 mm"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 7
    assert "width: expected a length above 0" in lines[0]
    assert "width: expected 1 mm to 10 m, got '4 parsec'" in lines[1]
    assert "did you mean 'aluminium'?" in lines[2]
    assert "did you mean 'TEC1-12706'?" in lines[3]
    assert lines[4:] == [
        "--at: expected such as \"2 cm, 2 cm\", got '3 cm 2 cm'",
        "--zones: expected such as 3x2, got '3'",
        "new rig: zones: expected 1 to 100 columns, got 0",
    ]
    assert len(load_rig("bench.toml").cells) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bench.toml"], "--width: expected a value, as there is nobody to ask"),
        (["bench.txt", *ARGUMENTS], "expected a name that ends with .toml"),
        (["no/bench.toml", *ARGUMENTS], "there is no folder"),
        (["bench.toml", *ARGUMENTS, "--at", "2 cm"], "--at: expected such as"),
        (["bench.toml", *ARGUMENTS, "--zones", "3"], "--zones: expected such as 3x2, got '3'"),
        (["bench.toml", *ARGUMENTS, "--zones", "axb"], "--zones: expected such as 3x2"),
    ],
)
def test_a_wrong_command_is_one_clear_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    assert run(["new-rig", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", example_rigs())
def test_a_rig_without_a_plate_is_written_after_an_example(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    example = load_rig(kind)
    name, row = next(iter(example.parameters.items()))
    other = 1.25 * row.value
    assert run(["new-rig", "mine.toml", "--kind", kind, "--value", f"{name}={other}"]) == 0
    rig = load_rig("mine.toml")
    assert rig.name == "mine"
    assert rig.parameters[name].value == pytest.approx(other)
    changed = {
        key for key, new in rig.parameters.items() if new.value != example.parameters[key].value
    }
    assert changed == {name}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--kind", "box"], "--kind: unknown kind 'box'"),
        (["--kind", "oven", "--value", "P=9"], "value.P: expected 200 to 4000 W, got 9"),
        (["--kind", "oven", "--value", "Q=9"], "value: unknown parameter 'Q'"),
        (["--kind", "oven", "--value", "P"], "--value: expected such as"),
        (["--kind", "oven", "--value", "P=hot"], "--value: P: expected a number, got 'hot'"),
        ([*ARGUMENTS, "--value", "P=9"], "--value: expected none for a plate"),
    ],
)
def test_a_wrong_kind_or_value_is_refused_and_nothing_is_written(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert run(["new-rig", "mine.toml", *arguments]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_a_person_is_asked_for_the_kind_and_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked: list[str] = []

    def prompt(question: str, default: str | None) -> str | None:
        asked.append(question)
        if question.startswith("kind of rig"):
            return "water-bath"
        return "12" if question.startswith("tau") else default

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr(typer, "prompt", prompt)
    assert run(["new-rig", "bath.toml"]) == 0
    assert load_rig("bath.toml").parameters["tau"].value == 12
    assert len(asked) == 8  # without the room, which belongs to a recording
