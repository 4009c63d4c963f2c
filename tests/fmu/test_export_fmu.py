"""An FMU of a twin, run by fmpy, beside `simulate`."""

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from heated_box import by_hand, cell_and_heater, heated_box
from radiating_rig import by_scipy, radiating_rig

from jaxtwin import Experiment, Stepper, Twin, export_fmu, simulate
from jaxtwin.c_export import _sources
from jaxtwin.errors import ControlError
from jaxtwin.fmu import FMU, _export_fmu
from jaxtwin.fmu._model_description import variables_of

VERSIONS: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0")

pytestmark = [pytest.mark.c_compiler, pytest.mark.fmpy]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="module", params=VERSIONS)
def fmu(twin: Twin, request: pytest.FixtureRequest, tmp_path_factory: Any) -> FMU:
    path = tmp_path_factory.mktemp("fmu") / "dual-cell.fmu"
    return export_fmu(twin, path, version=request.param, origin="dual-cell, as bundled")


def simulated(fmu: FMU, inputs: np.ndarray | None, **settings: Any) -> Any:
    from fmpy import simulate_fmu

    if inputs is not None:
        settings["input"] = inputs
    return simulate_fmu(str(fmu.path), step_size=1.0, **settings)


def drive(twin: Twin, seconds: int) -> np.ndarray:
    """A minute at each duty, as fmpy takes inputs: held from each time to the next."""
    names = [f"duty.{cell.name}" for cell in twin.netlist.cells]
    rows = np.zeros(seconds, dtype=[("time", float), *((name, float) for name in names)])
    rows["time"] = np.arange(seconds)
    levels = np.random.default_rng(0).uniform(-0.5, 1.0, (seconds // 60 + 1, len(names)))
    for column, name in enumerate(names):
        rows[name] = np.repeat(levels[:, column], 60)[:seconds]
    return rows


def test_the_description_is_that_of_the_standard(fmu: FMU):
    """By its XML schema, and fmpy's further checks of variables, units and structure."""
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu.path)) == []


@pytest.mark.slow
def test_ten_minutes_are_those_of_simulate(twin: Twin, fmu: FMU):
    """Duty cycles that change each minute; to the error of steps of a second."""
    rows = drive(twin, 601)
    found = simulated(fmu, rows, stop_time=600.0, output=[*fmu.outputs, "node.P1.TC"])
    duty = np.column_stack([rows[f"duty.{cell.name}"] for cell in twin.netlist.cells])
    expected = simulate(twin, Experiment(rows["time"], duty))
    assert len(found["time"]) == 601
    for number, channel in enumerate(twin.channels):
        np.testing.assert_allclose(
            found[channel], expected.temperatures[:, number], rtol=0, atol=5e-3, err_msg=channel
        )
    np.testing.assert_allclose(found["node.P1.TC"], expected.node("P1.TC"), rtol=0, atol=2e-2)


@pytest.mark.slow
def test_model_exchange_is_simulate_under_a_solver_from_outside(twin: Twin, fmu: FMU):
    """CVODE integrates the states; duty cycles change each minute, and arrive a delay later."""
    from fmpy import simulate_fmu

    names = [f"duty.{cell.name}" for cell in twin.netlist.cells]
    levels = np.random.default_rng(1).uniform(-0.5, 1.0, (5, len(names)))
    rows = np.zeros(10, dtype=[("time", float), *((name, float) for name in names)])
    rows["time"] = np.repeat(60.0 * np.arange(6), 2)[1:-1]  # each change is two rows at a time
    for column, name in enumerate(names):
        rows[name] = np.repeat(levels[:, column], 2)
    found = simulate_fmu(
        str(fmu.path),
        fmi_type="ModelExchange",
        input=rows,
        stop_time=300.0,
        output_interval=1.0,
        relative_tolerance=1e-7,
        output=[*fmu.outputs, "node.P1.TC", "der(node.P1.TC)"],
    )
    _, last = np.unique(found["time"][::-1], return_index=True)
    found = found[::-1][last]  # after the events
    times = np.arange(301.0)
    found = found[np.isin(found["time"], times)]
    duty = levels[np.minimum((times // 60).astype(int), 4)]
    expected = simulate(twin, Experiment(times, duty))
    for number, channel in enumerate(twin.channels):
        np.testing.assert_allclose(
            found[channel], expected.temperatures[:, number], rtol=0, atol=2e-3, err_msg=channel
        )
    side = found["node.P1.TC"]
    np.testing.assert_allclose(side, expected.node("P1.TC"), rtol=0, atol=5e-3)
    # Derivatives are those of what they are named after, where nothing arrives.
    calm = slice(20, 55)
    slope = (side[2:] - side[:-2])[calm] / 2
    np.testing.assert_allclose(found["der(node.P1.TC)"][1:-1][calm], slope, rtol=0, atol=1e-3)


def test_nodes_can_be_set_before_the_start_and_the_room_at_any_time(twin: Twin, fmu: FMU):
    """A plate as warm as the room stays so."""
    start = {f"node.{node.name}": 30.0 for node in twin.netlist.nodes}
    still = simulated(fmu, None, stop_time=60.0, start_values={**start, "ambient": 30.0})
    for channel in twin.channels:
        np.testing.assert_allclose(still[channel], 30.0, rtol=0, atol=1e-9)


def test_steps_of_the_simulator_need_not_be_those_of_the_twin(twin: Twin, fmu: FMU):
    """At the twin's own steps both are the same."""
    rows = drive(twin, 60)
    fine = simulated(fmu, rows, stop_time=50.0)
    from fmpy import simulate_fmu

    coarse = simulate_fmu(
        str(fmu.path), input=rows, step_size=0.25, output_interval=0.25, stop_time=50.0
    )
    np.testing.assert_allclose(coarse["T11"][::4], fine["T11"], rtol=0, atol=1e-12)


def test_inputs_are_held_from_the_beginning_of_each_step_of_the_twin(fmu: FMU):
    """Duty cycles and a room that change four times in each step, under a simulator that takes four
    steps in it."""
    from fmpy import simulate_fmu

    names = ["duty.P1", "duty.P2", "ambient"]
    rows = np.zeros(81, dtype=[("time", float), *((name, float) for name in names)])
    rows["time"] = 0.25 * np.arange(81)
    rng = np.random.default_rng(2)
    rows["duty.P1"], rows["duty.P2"] = rng.uniform(-1, 1, (2, 81))
    rows["ambient"] = rng.uniform(10, 30, 81)
    output = ["node.V11", "node.P1.TC"]
    fine, held = (
        simulate_fmu(
            str(fmu.path),
            input=table,
            step_size=step,
            output_interval=step,
            stop_time=20.0,
            output=output,
        )
        for table, step in ((rows, 0.25), (rows[::4], 1.0))
    )
    for name in output:
        np.testing.assert_allclose(fine[name][::4], held[name], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [("duty.P1", 1.5), ("duty.P1", np.nan), ("ambient", np.inf), ("ambient", -300.0)],
)
def test_inputs_that_are_out_of_range_or_not_finite_are_refused(fmu: FMU, name: str, value: float):
    with pytest.raises(Exception, match=r"fmi[23]Set(Real|Float64)"):
        simulated(fmu, None, stop_time=2.0, start_values={name: value})


class Instance:
    """An instance by the functions of the standard, and what it has said."""

    def __init__(self, fmu: FMU, folder: Path):
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(str(fmu.path))
        self.is_2 = description.fmiVersion == "2.0"
        self.numbers = {v.name: v.valueReference for v in description.modelVariables}
        co_simulation = description.coSimulation
        assert co_simulation is not None
        self.by_hand: Any = (FMU2Slave if self.is_2 else FMU3Slave)(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(fmu.path), str(folder)),
            modelIdentifier=co_simulation.modelIdentifier,
            instanceName="plate",
        )
        self.by_hand.instantiate()

    def begin(self) -> None:
        if self.is_2:
            self.by_hand.setupExperiment(startTime=0.0)
        self.by_hand.enterInitializationMode()
        self.by_hand.exitInitializationMode()

    def read(self, name: str) -> float:
        read = self.by_hand.getReal if self.is_2 else self.by_hand.getFloat64
        return read([self.numbers[name]])[0]

    def write(self, name: str, value: float) -> None:
        write = self.by_hand.setReal if self.is_2 else self.by_hand.setFloat64
        write([self.numbers[name]], [value])

    def steps(self, first: int, count: int) -> float:
        """Takes steps of a second with a duty of 0.7; the reading behind them."""
        self.write("duty.P1", 0.7)
        for second in range(first, first + count):
            self.by_hand.doStep(currentCommunicationPoint=float(second), communicationStepSize=1.0)
        return self.read("T11")


def test_a_state_is_kept_and_gone_back_to(fmu: FMU, tmp_path: Path):
    """By the functions of the standard: the same steps again are the same, also those of another
    instance that gets the bytes of the state."""
    instance, other = Instance(fmu, tmp_path / "a"), Instance(fmu, tmp_path / "b")
    instance.begin()
    state = instance.by_hand.getFMUState()
    start, end = instance.read("T11"), instance.steps(0, 10)
    assert end > start
    instance.by_hand.setFMUState(state)
    assert instance.steps(0, 10) == end
    half = instance.by_hand.getFMUState()
    serialize, deserialize = (
        instance.by_hand.serializeFMUState,
        other.by_hand.deserializeFMUState,
    )
    content = serialize(half)
    other.begin()
    other.by_hand.setFMUState(deserialize(content))
    assert other.steps(10, 10) == instance.steps(10, 10)
    with pytest.raises(Exception, match=r"fmi[23]De[Ss]erialize"):
        deserialize(bytes(len(content)))
    for made in (instance, other):
        made.by_hand.terminate()
        made.by_hand.freeInstance()


def test_a_second_run_needs_a_reset(fmu: FMU, tmp_path: Path):
    instance = Instance(fmu, tmp_path)
    instance.begin()
    end = instance.steps(0, 10)
    instance.by_hand.terminate()
    assert instance.read("T11") == end
    with pytest.raises(Exception, match=r"fmi[23]DoStep"):
        instance.steps(10, 1)
    with pytest.raises(Exception, match=r"fmi2SetupExperiment|fmi3EnterInitializationMode"):
        instance.begin()
    instance.by_hand.reset()
    instance.begin()
    assert instance.steps(0, 10) == end
    instance.by_hand.freeInstance()


def test_time_does_not_go_back_and_a_step_needs_an_initialisation(fmu: FMU, tmp_path: Path):
    instance = Instance(fmu, tmp_path)
    with pytest.raises(Exception, match=r"fmi[23]DoStep"):
        instance.steps(0, 1)
    instance.begin()
    instance.steps(0, 10)
    with pytest.raises(Exception, match=r"fmi[23]DoStep"):
        instance.steps(5, 1)
    instance.by_hand.freeInstance()


def test_sources_compile_without_a_warning_and_need_no_other_header(fmu: FMU, tmp_path: Path):
    with zipfile.ZipFile(fmu.path) as archive:
        names = [name for name in archive.namelist() if name.startswith("sources/")]
        archive.extractall(tmp_path, names)
        assert any(name.startswith("binaries/") for name in archive.namelist())
    assert "dual-cell, as bundled" in (tmp_path / "sources/twin_dual_cell.h").read_text()
    command = [shutil.which("cc") or "cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    for file in tmp_path.glob("sources/*.c"):
        subprocess.run([*command, "-c", str(file), "-o", str(tmp_path / "out.o")], check=True)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_c_files_compile_as_they_stand(
    version: Literal["2.0", "3.0"], twin: Twin, tmp_path: Path
):
    """Before a name is put into them, with the numbers of a twin whose name is `model`."""
    stepper = Stepper(twin, 1.0)
    variables = variables_of(twin, stepper)
    sources = _export_fmu._sources(twin, stepper, variables, "model", version, "")
    for name in ("model.h", "model_fmu.h", "model_numbers.h"):
        (tmp_path / name).write_text(sources[name])
    file = Path(_export_fmu.__file__).with_name(f"fmi{version[0]}.c")
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow"]
    command += ["-Wconversion", "-Wundef", "-fsyntax-only", "-I", str(tmp_path)]
    for source in (file, _sources.FOLDER / "parametric_twin.c"):
        done = subprocess.run([*command, str(source)], capture_output=True, text=True, check=False)
        assert not done.returncode, done.stderr


# The functions that take a structure or callbacks, which the sources need not know.
OPAQUE = {
    "2.0": {"fmi2Instantiate", "fmi2NewDiscreteStates"},
    "3.0": {
        "fmi3InstantiateModelExchange",
        "fmi3InstantiateCoSimulation",
        "fmi3InstantiateScheduledExecution",
    },
}


@pytest.mark.parametrize("version", VERSIONS)
def test_functions_are_those_of_the_standards_headers(
    version: Literal["2.0", "3.0"], twin: Twin, tmp_path: Path
):
    """As fmpy bundles them: a C compiler says which functions have other arguments. Enumerations
    are passed as int."""
    import fmpy

    fmu = export_fmu(twin, tmp_path / "plate.fmu", version=version, compiler=None)
    zipfile.ZipFile(fmu.path).extractall(tmp_path)
    (wrapper,) = tmp_path.glob("sources/fmi[23].c")
    for header in Path(fmpy.__file__).with_name("c-code").glob(f"{wrapper.stem}*.h"):
        text = re.sub(r"typedef enum {[^}]*}\s*(\w+)", r"typedef int \1", header.read_text())
        (tmp_path / header.name).write_text(text)
    command = [shutil.which("cc") or "cc", "-std=c99", "-fsyntax-only", "-include"]
    command += [str(tmp_path / f"{wrapper.stem}Functions.h"), str(wrapper)]
    english = os.environ | {"LC_ALL": "C"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=english)
    assert set(re.findall(r"conflicting types for .(\w+)", done.stderr)) == OPAQUE[version]
    assert done.stderr.count("error:") == len(OPAQUE[version]), done.stderr


def test_the_same_twin_is_the_same_file(twin: Twin, fmu: FMU, tmp_path: Path):
    version = "2.0" if "fmi2" in str(zipfile.ZipFile(fmu.path).namelist()) else "3.0"
    again = export_fmu(
        twin, tmp_path / "again.fmu", version=version, origin="dual-cell, as bundled"
    )
    assert again.path.read_bytes() == fmu.path.read_bytes()


def test_what_cannot_be_written_is_refused(twin: Twin, tmp_path: Path):
    arguments: Any
    for arguments, message in (
        (
            {"compiler": "no-such-cc"},
            "compiler: expected a C compiler, got 'no-such-cc', which is not found",
        ),
        ({"compiler": "false"}, "compiler: false failed"),
    ):
        with pytest.raises(ControlError, match=message):
            export_fmu(twin, tmp_path / "a.fmu", **arguments)
    with pytest.raises(ControlError, match=r"ending: expected \.fmu"):
        export_fmu(twin, tmp_path / "a.zip")
    assert not list(tmp_path.iterdir())
    alone = export_fmu(twin, tmp_path / "sources.fmu", compiler=None)
    assert alone.binary is None
    assert not any("binaries" in name for name in zipfile.ZipFile(alone.path).namelist())


def test_a_duty_cycle_is_between_full_cooling_and_full_heating(twin: Twin):
    rows = variables_of(twin, Stepper(twin, 1.0))
    limits = {row.name: row.limits for row in rows if row.causality == "input"}
    assert limits == {"duty.P1": (-1.0, 1.0), "duty.P2": (-1.0, 1.0), "ambient": None}


@pytest.mark.slow
def test_heaters_are_inputs_from_0_to_1_and_simulate_as_the_twin(tmp_path: Path):
    twin = Twin(cell_and_heater("on-off"))
    variables = {row.name: row for row in variables_of(twin, Stepper(twin, 1.0))}
    assert variables["duty.P1"].limits == (-1.0, 1.0)
    assert variables["duty.foil"].limits == (0.0, 1.0)
    box = Twin(heated_box())
    fmu = export_fmu(box, tmp_path / "box.fmu", version="2.0")
    rows = np.zeros(61, dtype=[(name, float) for name in ("time", "duty.heater", "duty.bulb")])
    rows["time"], rows["duty.heater"], rows["duty.bulb"] = np.arange(61), 0.8, 0.3
    found = simulated(fmu, rows, stop_time=60.0, output=["node.air"])
    expected = by_hand((0.8, 0.3), 60.0)[0]
    assert found["node.air"][-1] == pytest.approx(expected, abs=1e-3)


def test_exponents_and_emissivities_are_parameters_of_an_fmu(tmp_path: Path):
    """Set before the start, against SciPy, to the error of steps of a second."""
    fmu = export_fmu(Twin(radiating_rig()), tmp_path / "radiating.fmu")
    values = {"eps": 0.5, "g": 0.2, "n": 0.3, "p": 1.6}
    rows = np.zeros(61, dtype=[("time", float), ("duty.H", float)])
    rows["time"], rows["duty.H"] = np.arange(0, 610, 10), 0.7
    found = simulated(fmu, rows, stop_time=600.0, output=["T1", "T2"], start_values=values)
    every_ten = np.column_stack([found["T1"], found["T2"]])[::10]
    expected = by_scipy(Experiment(rows["time"], rows["duty.H"][:, None]), **values)
    np.testing.assert_allclose(every_ten, expected, rtol=0, atol=5e-3)
