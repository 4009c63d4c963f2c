"""docs/rig-files.md against what the reader of rig files takes: the page cannot go stale."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest

from jaxtwin import Experiment, Twin, load_rig, simulate
from jaxtwin.rig import _schema as schema
from jaxtwin.rig import bundled_materials, bundled_modules, load_module

PAGE = (Path(__file__).parents[2] / "docs" / "rig-files.md").read_text(encoding="utf-8")

TABLES = {
    "`top level`": schema.RigTable,
    "`[plate]`": schema.PlateTable,
    "`[circuit]`": schema.CircuitTable,
    "`[[circuit.links]]`": schema.LinkTable,
    "`[[cells]]`": schema.CellTable,
    "`fan` of a cell or a link": schema.FanTable,
    "`[[heaters]]`": schema.HeaterTable,
    "`time_proportional` of a heater": schema.TimeProportionalTable,
    "`[[bodies]]`": schema.BodyTable,
    "`[[links]]`": schema.BodyLinkTable,
    "`[driver]`": schema.DriverTable,
    "`[[inputs]]`": schema.InputTable,
    "`[sensors]`": schema.SensorsTable,
    "`[camera]`": schema.CameraTable,
    "`[camera.view]`": schema.ViewTable,
    "`[camera.common_error]`": schema.CommonErrorTable,
    "`[camera.registration]`": schema.RegistrationTable,
    "`[[channels]]`": schema.ChannelTable,
    "`[limits]`": schema.LimitsTable,
    "`[ambient]`": schema.AmbientTable,
    "`[initial]`": schema.InitialTable,
    "`[parameters]`": schema.ParameterTable,
    "`prior` of a parameter": schema.PriorTable,
}


def rows(heading: str) -> dict[str, tuple[str, str]]:
    """Key -> (what it is, whether it is needed) of the table under a heading."""
    (section,) = [part for part in PAGE.split("\n## ") if part.splitlines()[0].endswith(heading)]
    found = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \|$", section, re.MULTILINE)
    return {key: (what, needed) for key, what, needed in found}


def test_every_table_of_the_schema_has_its_place():
    tables = {
        kind
        for kind in vars(schema).values()
        if isinstance(kind, type) and issubclass(kind, schema.SchemaTable)
    }
    assert tables - set(TABLES.values()) == {
        schema.SchemaTable,
        schema.ModuleTable,
        schema.MaterialTable,
    }


@pytest.mark.parametrize(("heading", "model"), TABLES.items(), ids=lambda value: str(value))
def test_a_table_has_every_key_and_says_which_are_needed(heading: str, model: Any):
    page = rows(heading)
    assert list(page) == list(model.model_fields)
    for key, field in model.model_fields.items():
        needed = page[key][1]
        if field.is_required():
            assert needed == "yes", key
        elif field.default is None:
            assert needed == "no", key
        else:
            assert needed == f"no, `{json.dumps(field.default)}`", key


@pytest.mark.parametrize(("heading", "model"), TABLES.items(), ids=lambda value: str(value))
def test_where_words_are_chosen_from_all_of_them_are_named(heading: str, model: Any):
    for key, field in model.model_fields.items():
        for word in get_args(field.annotation):
            if isinstance(word, str):
                assert f'`"{word}"`' in rows(heading)[key][0]


@pytest.mark.slow
def test_the_example_is_a_rig_that_runs(tmp_path):
    example = re.findall(r"```toml\n(.+?)```", PAGE, re.DOTALL)[0]
    file = tmp_path / "small.toml"
    file.write_text(example, encoding="utf-8")
    rig = load_rig(file)
    assert set(rig.parameters) == set(tomllib.loads(example)["parameters"])
    run = simulate(Twin(rig), Experiment.schedule("0:0.5", duration=100))
    assert run.channel("T1")[-1] > run.channel("T1")[0] + 5


def test_the_example_without_a_plate_is_a_rig_that_runs(tmp_path):
    (example,) = [
        text for text in re.findall(r"```toml\n(.+?)```", PAGE, re.DOTALL) if "mug" in text
    ]
    file = tmp_path / "mug.toml"
    file.write_text(example, encoding="utf-8")
    rig = load_rig(file)
    assert not rig.has_plate
    run = simulate(Twin(rig), Experiment.schedule("0:1", duration=600))
    # 300 W for 10 minutes into 1650 J/K, less what is lost.
    assert 60 < run.channel("T_water")[-1] - run.channel("T_water")[0] < 110


@pytest.mark.parametrize("name", bundled_modules())
def test_the_numbers_of_the_modules_are_those_of_their_files(name: str):
    found = re.search(rf"^\| `{re.escape(name)}` \| (.+) \|$", PAGE, re.MULTILINE)
    assert found is not None
    module = load_module(name)
    hot, difference = module.hot_side_temperature, module.maximum_temperature_difference
    power = module.maximum_voltage * module.maximum_current
    stated = module.maximum_heat_flow
    assert found[1].split(" | ")[1:] == [
        f"{module.maximum_current:g}",
        f"{module.maximum_voltage:g}",
        f"{difference:g}",
        f"{hot:g}",
        f"{module.seebeck_coefficient:.4f}",
        f"{module.electrical_resistance:.3g}",
        f"{module.thermal_resistance:.3g}",
        f"{power * (hot + difference) / (2 * hot):.3g}",
        "–" if stated is None else f"{stated:g}",
    ]


def test_the_modules_that_come_along_are_named():
    named = rows("`[[cells]]`")["module"][0]
    assert all(f"`{name}`" in named for name in bundled_modules())


def test_the_materials_that_come_along_are_named():
    named = rows("`[plate]`")["material"][0]
    assert re.findall("`(.+?)`", named) == list(bundled_materials())
