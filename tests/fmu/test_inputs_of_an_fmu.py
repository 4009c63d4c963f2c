"""The inputs of an FMU besides duty and ambient: a lid that opens, a fan, a coolant."""

import subprocess
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from jaxtwin import Experiment, Stepper, Twin, export_fmu, simulate
from jaxtwin.fmu import FMU, _export_fmu
from jaxtwin.fmu._model_description import variables_of

VERSIONS: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0")

CHANGES = {
    "heated-box": {"lid": "0:0,200:1,260:0,410:1", "fan": "0:1,100:0.3,330:0,500:1.4"},
    "battery-pack": {"flow": "0:1,150:0,300:0.6", "T_coolant": "0:20,240:12,420:31.5"},
}

pytestmark = [pytest.mark.c_compiler, pytest.mark.fmpy]


@pytest.fixture(scope="module", params=CHANGES)
def twin(request: pytest.FixtureRequest) -> Twin:
    return Twin(request.param)


@pytest.fixture(scope="module", params=VERSIONS)
def fmu(twin: Twin, request: pytest.FixtureRequest, tmp_path_factory: Any) -> FMU:
    path = tmp_path_factory.mktemp("fmu") / "twin.fmu"
    return export_fmu(twin, path, version=request.param)


def ten_minutes(twin: Twin) -> Experiment:
    duty = np.array([0.3, 0.9, 0.5])[: len(twin.rig.driven)]
    time = np.arange(601.0)
    drive = np.where(time[:, None] < 300, duty, 0.4 * duty)
    inputs = Experiment.schedule("0:0", duration=600, step=1, inputs=CHANGES[twin.rig.name]).inputs
    return Experiment(time, drive).with_inputs(**inputs)


def rows_of(twin: Twin, experiment: Experiment) -> np.ndarray:
    """As fmpy takes inputs; the numbers of states are whole numbers."""
    whole = {one.name: bool(one.states) for one in twin.rig.inputs}
    columns: dict[str, tuple[Any, Any]] = {"time": (float, experiment.time)}
    for name, column in zip(twin.rig.driven, experiment.duty.T, strict=True):
        columns[f"duty.{name}"] = float, column
    for name, column in experiment.inputs.items():
        columns[f"input.{name}"] = np.int32 if whole[name] else float, column
    rows = np.zeros(
        len(experiment.time), dtype=[(name, kind) for name, (kind, _) in columns.items()]
    )
    for name, (_, column) in columns.items():
        rows[name] = column
    return rows


@pytest.mark.slow
def test_the_description_is_that_of_the_standard(fmu: FMU):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu.path)) == []


@pytest.mark.slow
def test_ten_minutes_in_which_inputs_change_are_those_of_simulate(twin: Twin, fmu: FMU):
    """To the error of steps of a second."""
    from fmpy import simulate_fmu

    experiment = ten_minutes(twin)
    nodes = [f"node.{node.name}" for node in twin.netlist.nodes]
    found = simulate_fmu(
        str(fmu.path),
        input=rows_of(twin, experiment),
        stop_time=600.0,
        step_size=1.0,
        output_interval=1.0,
        output=[*fmu.outputs, *nodes],
    )
    run = simulate(twin, experiment)
    expected = np.hstack([run.temperatures, run.states])
    assert len(found["time"]) == 601
    for name, column in zip([*fmu.outputs, *nodes], expected.T, strict=True):
        np.testing.assert_allclose(found[name], column, rtol=0, atol=5e-5, err_msg=name)


@pytest.mark.slow
def test_model_exchange_with_inputs_is_simulate(twin: Twin, fmu: FMU):
    """CVODE integrates the states; each change is an event, two rows at one time."""
    from fmpy import simulate_fmu

    experiment = ten_minutes(twin)
    rows = rows_of(twin, experiment)
    names = [name for name in rows.dtype.names or () if name != "time"]
    table = [rows[0]]
    for old, new in pairwise(rows):
        if any(old[name] != new[name] for name in names):
            before = old.copy()
            before["time"] = new["time"]
            table += [before, new]
    found = simulate_fmu(
        str(fmu.path),
        fmi_type="ModelExchange",
        input=np.array([*table, rows[-1]], rows.dtype),
        stop_time=600.0,
        output_interval=1.0,
        relative_tolerance=1e-7,
        output=list(fmu.outputs),
    )
    _, last = np.unique(found["time"][::-1], return_index=True)
    found = found[::-1][last]
    found = found[np.isin(found["time"], experiment.time)]
    run = simulate(twin, experiment)
    for name, column in zip(fmu.outputs, run.temperatures.T, strict=True):
        np.testing.assert_allclose(found[name], column, rtol=0, atol=2e-3, err_msg=name)


@pytest.mark.slow
def test_inputs_that_are_not_set_are_those_of_the_rig_file(twin: Twin, fmu: FMU):
    from fmpy import simulate_fmu

    names = [f"duty.{name}" for name in twin.rig.driven]
    start = dict.fromkeys(names, 0.5)
    settings: Any = {"stop_time": 60.0, "step_size": 1.0}
    found = simulate_fmu(str(fmu.path), start_values=start, **settings)
    given = start | {f"input.{one.name}": one.value for one in twin.rig.inputs}
    also = {name: int(value) if name == "input.lid" else value for name, value in given.items()}
    again = simulate_fmu(str(fmu.path), start_values=also, **settings)
    run = simulate(twin, Experiment(np.arange(61.0), np.full((61, len(names)), 0.5)))
    for channel, column in zip(fmu.outputs, run.temperatures.T, strict=True):
        np.testing.assert_allclose(found[channel], column, rtol=0, atol=5e-5)
        np.testing.assert_array_equal(found[channel], again[channel])


@pytest.mark.parametrize("version", VERSIONS)
def test_states_are_an_enumeration_with_their_names(version: Any, tmp_path: Path):
    fmu = export_fmu(Twin("heated-box"), tmp_path / "a.fmu", version=version, compiler=None)
    assert fmu.inputs == ("duty.heater", "ambient", "input.lid", "input.fan")
    text = zipfile.ZipFile(fmu.path).read("modelDescription.xml")
    items = [item.attrib for item in ET.fromstring(text).iter("Item")]
    assert items == [{"name": "closed", "value": "0"}, {"name": "open", "value": "1"}]


@pytest.mark.parametrize(
    ("name", "value"), [("input.lid", 2), ("input.lid", -1), ("duty.heater", -0.2)]
)
def test_states_that_a_lid_does_not_have_and_cooling_are_refused(
    name: str, value: float, tmp_path: Path
):
    from fmpy import simulate_fmu

    fmu = export_fmu(Twin("heated-box"), tmp_path / "a.fmu")
    with pytest.raises(Exception, match="fmi2Set"):
        simulate_fmu(str(fmu.path), start_values={name: value}, stop_time=1.0)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_compile_without_a_warning(version: Any, twin: Twin, tmp_path: Path):
    stepper = Stepper(twin, 1.0)
    variables = variables_of(twin, stepper)
    sources = _export_fmu._sources(twin, stepper, variables, "model", version, "")
    for name, text in sources.items():
        (tmp_path / name).write_text(text)
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow"]
    command += ["-Wconversion", "-Wundef", "-fsyntax-only"]
    command += [str(tmp_path / name) for name in ("model.c", f"fmi{version[0]}.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
