"""The parameters of a twin in its FMU: set before the start, as `Twin.with_values` in Python."""

import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree as ET

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from heated_box import cell_and_heater, heated_box
from placed_rig import MOVING, placed_rig

from jaxtwin import Stepper, Twin, export_fmu
from jaxtwin._celsius import ZERO_CELSIUS
from jaxtwin.errors import SimulationError
from jaxtwin.fmu import FMU

VERSIONS: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0")

SECONDS = 60

pytestmark = [pytest.mark.c_compiler, pytest.mark.fmpy, pytest.mark.usefixtures("float64")]


@pytest.fixture(scope="module", params=VERSIONS)
def version(request: pytest.FixtureRequest) -> Literal["2.0", "3.0"]:
    return request.param


@pytest.fixture(scope="module", params=["dual-cell", "heated-box"])
def twin(request: pytest.FixtureRequest) -> Twin:
    return Twin(request.param)


@pytest.fixture(scope="module")
def fmu(twin: Twin, version: Literal["2.0", "3.0"], tmp_path_factory: Any) -> FMU:
    return export_fmu(twin, tmp_path_factory.mktemp("fmu") / "twin.fmu", version=version)


def other_values(twin: Twin, fmu: FMU, seed: int, factor: float = 1.25) -> dict[str, float]:
    """Another value for every parameter, within its bounds."""
    random, values = np.random.default_rng(seed), {}
    for name in fmu.parameters:
        row = twin.rig.parameters[name]
        drawn = row.value * random.uniform(1 / factor, factor)
        values[name] = float(np.clip(drawn, row.lower, row.upper))
    return values


def in_fmu(twin: Twin, fmu: FMU, values: Mapping[str, float], **settings: Any) -> np.ndarray:
    """Channels and nodes after each second, under duty cycles that change every twenty seconds."""
    from fmpy import simulate_fmu

    names = [f"duty.{name}" for name in twin.rig.driven]
    rows = np.zeros(SECONDS + 1, dtype=[(name, float) for name in ("time", *names)])
    rows["time"] = np.arange(SECONDS + 1)
    for name, column in zip(names, duty(twin).T, strict=True):
        rows[name] = column
    output = [*fmu.outputs, *(f"node.{node.name}" for node in twin.netlist.nodes)]
    found = simulate_fmu(
        str(fmu.path), input=rows, start_values=dict(values), output=output, step_size=1.0,
        stop_time=float(SECONDS), output_interval=1.0, **settings,
    )  # fmt: skip
    return np.column_stack([found[name] for name in output])


def duty(twin: Twin) -> np.ndarray:
    lowest = 0.5 * twin.wiring.lowest_duty
    levels = np.random.default_rng(3).uniform(lowest, 1.0, (SECONDS // 20 + 1, len(lowest)))
    return levels.repeat(20, axis=0)[: SECONDS + 1]


def in_python(twin: Twin, values: Mapping[str, float]) -> np.ndarray:
    stepper = Stepper(twin.with_values(values), 1.0)
    state = stepper.start()
    rows = [[*stepper.channels(state), *state.nodes]]
    for command in duty(twin)[:-1]:
        state = stepper.step(state, command)
        rows.append([*stepper.channels(state), *state.nodes])
    return np.array(rows, float)


@contextmanager
def instance(fmu: FMU, kind: Literal["CoSimulation", "ModelExchange"]) -> Iterator[Any]:
    """An instance in fmpy, with `read`, `write` and `initialize` in both versions of FMI."""
    import fmpy
    from fmpy.fmi2 import FMU2Model, FMU2Slave
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    description: Any = fmpy.read_model_description(str(fmu.path))
    is_2 = description.fmiVersion == "2.0"
    numbers = {one.name: one.valueReference for one in description.modelVariables}
    of_kind = {
        "CoSimulation": (FMU2Slave, FMU3Slave, description.coSimulation),
        "ModelExchange": (FMU2Model, FMU3Model, description.modelExchange),
    }[kind]
    with tempfile.TemporaryDirectory() as folder:
        made: Any = of_kind[0 if is_2 else 1](
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(fmu.path), folder),
            modelIdentifier=of_kind[2].modelIdentifier,
            instanceName="plate",
        )
        made.instantiate()

        def read(*names: str) -> list[float]:
            return (made.getReal if is_2 else made.getFloat64)([numbers[name] for name in names])

        def write(values: Mapping[str, float]) -> None:
            (made.setReal if is_2 else made.setFloat64)(
                [numbers[name] for name in values], list(values.values())
            )

        def initialize() -> None:
            if is_2:
                made.setupExperiment(startTime=0.0)
            made.enterInitializationMode()
            made.exitInitializationMode()

        made.read, made.write, made.initialize = read, write, initialize
        yield made
        made.freeInstance()


def rows_of(fmu: FMU) -> dict[str, dict[str, str]]:
    """The attributes of the parameters in the description."""
    root = ET.fromstring(zipfile.ZipFile(fmu.path).read("modelDescription.xml"))
    listed: Any = root.find("ModelVariables")
    rows = [{**row.attrib, **(row[0].attrib if len(row) else {})} for row in listed]
    return {row["name"]: row for row in rows if row["causality"] == "parameter"}


def test_the_description_has_their_units_bounds_and_values(twin: Twin, fmu: FMU):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu.path)) == []
    found = rows_of(fmu)
    assert tuple(found) == fmu.parameters
    for name, row in found.items():
        expected = twin.rig.parameters[name]
        assert row["variability"] == "fixed"
        assert row.get("unit", "") == expected.unit
        bounds = [float(row[key]) for key in ("start", "min", "max")]
        assert bounds == [expected.value, expected.lower, expected.upper]
        assert row["description"] == (expected.description or "Parameter of the rig")


def test_units_are_those_of_the_si(fmu: FMU):
    """J/K is kg m2 s-2 K-1."""
    root = ET.fromstring(zipfile.ZipFile(fmu.path).read("modelDescription.xml"))
    units = {unit.attrib["name"]: unit[0].attrib for unit in root.iter("Unit")}
    assert units["J/K"] == {"kg": "1", "m": "2", "s": "-2", "K": "-1"}
    assert units["degC"] == {"K": "1", "offset": "273.15"}


def test_those_that_are_no_parameters_set_the_start_the_room_or_the_camera(twin: Twin, fmu: FMU):
    others = {
        "dual-cell": {"T_amb", "T_amb_drift", "T_start", "d_x", "d_y", "s_view", "r_view"},
        "heated-box": {"T_amb"},
    }[twin.rig.name]
    assert set(twin.rig.parameters) - set(fmu.parameters) == others


def test_other_values_are_the_twin_with_these_values(twin: Twin, fmu: FMU):
    """All parameters at once; thermal, electrical, losses, the lag and the delay of the driver."""
    values = other_values(twin, fmu, 0)
    found = in_fmu(twin, fmu, values)
    np.testing.assert_allclose(found, in_python(twin, values), rtol=0, atol=1e-9)
    assert np.ptp(found - in_fmu(twin, fmu, {})) > 1.0


@pytest.mark.slow
def test_any_delay_within_its_bounds_is_exact(tmp_path: Path):
    """Between and at steps of a second, and at both bounds."""
    twin = Twin("dual-cell")
    fmu = export_fmu(twin, tmp_path / "twin.fmu")
    for delay in (0.02, 0.6, 1.0, 3.0, 7.3, 60.0):
        values = {"t_delay": delay}
        expected = in_python(twin, values)
        np.testing.assert_allclose(in_fmu(twin, fmu, values), expected, rtol=0, atol=1e-9)


RIGS = {
    "mean voltage and a current limit": lambda: Twin(cell_and_heater("voltage")),
    "on and off and a current limit": lambda: Twin(cell_and_heater("on-off")),
    "heaters": lambda: Twin(heated_box()),
    "a body of a given temperature and inputs": lambda: Twin("battery-pack"),
    "a body of a given temperature": lambda: Twin("water-bath"),
    "a cell whose place is a parameter": lambda: Twin(placed_rig(MOVING)),
    "infinite bounds": lambda: Twin("paper-2024"),
}


@pytest.mark.slow
@pytest.mark.parametrize("key", RIGS)
def test_every_kind_of_rig_is_the_twin_with_other_values(key: str, tmp_path: Path):
    twin = RIGS[key]()
    fmu = export_fmu(twin, tmp_path / "twin.fmu")
    values = other_values(twin, fmu, 0)
    np.testing.assert_allclose(
        in_fmu(twin, fmu, values), in_python(twin, values), rtol=0, atol=1e-9
    )


def test_places_on_the_plate_are_no_parameters(tmp_path: Path):
    twin = Twin(placed_rig(MOVING))
    assert export_fmu(twin, tmp_path / "a.fmu", compiler=None).parameters == ("R_contact",)


def test_a_twin_with_matched_values_starts_with_them(tmp_path: Path):
    """Also where they are outside the bounds of the rig, which a match may widen."""
    twin = Twin("dual-cell", {"R_E": 2.2, "R_Th": 6.0})
    rows = rows_of(export_fmu(twin, tmp_path / "a.fmu", compiler=None))
    assert (rows["R_E"]["start"], rows["R_E"]["max"]) == ("2.2", "4.0")
    assert (rows["R_Th"]["start"], rows["R_Th"]["max"]) == ("6.0", "6.0")


def test_derivatives_of_model_exchange_are_the_equations(twin: Twin, fmu: FMU):
    """dT/dt = (heat into the node) / (heat capacity), of the network as Python assembles it."""
    values, nodes = other_values(twin, fmu, 2), [node.name for node in twin.netlist.nodes]
    random = np.random.default_rng(0)
    start = random.uniform(15.0, 45.0, len(nodes))
    command = random.uniform(0.2, 0.9, len(twin.rig.driven))
    kind = "duty" if twin.wiring.lag is None else "lagged_duty"
    driven = {f"{kind}.{name}": value for name, value in zip(twin.rig.driven, command, strict=True)}
    with instance(fmu, "ModelExchange") as made:
        made.write(values)
        made.write({f"node.{name}": value for name, value in zip(nodes, start, strict=True)})
        made.write(driven)
        made.initialize()
        found = made.read(*(f"der(node.{name})" for name in nodes))

    @eqx.filter_jit
    def slopes(twin: Twin) -> Any:
        system = twin.system()
        room = system.ambient_temperature
        heat = system.heat_into_nodes(
            jnp.asarray(start) + ZERO_CELSIUS - room, jnp.asarray(command), room
        )
        return heat / system.capacitance

    np.testing.assert_allclose(found, slopes(twin.with_values(values)), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_values_can_be_read_and_reset_gives_those_of_the_file(twin: Twin, fmu: FMU):
    values = other_values(twin, fmu, 0)
    with instance(fmu, "CoSimulation") as made:
        made.write(values)
        assert made.read(*values) == list(values.values())
        made.initialize()
        made.reset()
        assert made.read(*values) == [twin.rig.parameters[name].value for name in values]
        made.initialize()
        assert made.read(*fmu.outputs) == pytest.approx(
            in_fmu(twin, fmu, {})[0][: len(fmu.outputs)]
        )


def test_a_stored_state_goes_to_another_instance_with_its_parameters(twin: Twin, fmu: FMU):
    """Whose own parameters then no longer count."""
    values = other_values(twin, fmu, 0)
    drive = {f"duty.{name}": 0.6 for name in twin.rig.driven}

    def minute(made: Any) -> list[float]:
        made.write(drive)
        for second in range(10):
            made.doStep(currentCommunicationPoint=float(second), communicationStepSize=1.0)
        return made.read(*fmu.outputs)

    with instance(fmu, "CoSimulation") as first:
        first.write(values)
        first.initialize()
        state = first.getFMUState()
        with instance(fmu, "CoSimulation") as second:
            second.initialize()
            second.setFMUState(state)
            assert minute(second) == minute(first)
        first.freeFMUState(state)


def test_a_value_outside_its_bounds_or_not_finite_is_refused_in_a_sentence(
    fmu: FMU, capsys: pytest.CaptureFixture[str]
):
    name = "R_E" if "R_E" in fmu.parameters else "R_wall"
    ends = {"R_E": "1 to 4", "R_wall": "0.2 to 20"}[name]
    for value, told in (
        (99.0, f"{name}: expected {ends}, got 99"),
        (0.0, f"{name}: expected {ends}, got 0"),
        (np.nan, f"{name}: expected a finite number, got nan"),
        (np.inf, f"{name}: expected a finite number, got inf"),
    ):
        with instance(fmu, "CoSimulation") as made:
            with pytest.raises(Exception, match=r"fmi[23]Set(Real|Float64)"):
                made.write({name: value})
            assert f"[ERROR] {told}\n" in capsys.readouterr().out
            made.initialize()  # the value that was refused is not there


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_parameter_cannot_be_set_after_the_initialisation(
    kind: Literal["CoSimulation", "ModelExchange"], fmu: FMU, capsys: pytest.CaptureFixture[str]
):
    name = fmu.parameters[0]
    with instance(fmu, kind) as made:
        made.initialize()
        with pytest.raises(Exception, match=r"fmi[23]Set(Real|Float64)"):
            made.write({name: made.read(name)[0]})
    told = f"{name}: expected to be set before the end of the initialisation, not after it"
    assert told in capsys.readouterr().out


def test_inputs_and_outputs_are_refused_in_sentences_too(
    fmu: FMU, capsys: pytest.CaptureFixture[str]
):
    output = fmu.outputs[0]
    expected = "expected an input, a start value or a parameter, got another variable"
    for name, value, told in (
        ("ambient", np.nan, "ambient: expected a finite number, got nan"),
        (fmu.inputs[0], 1.5, f"{fmu.inputs[0]}: expected "),
        (output, 20.0, f"{output}: {expected}"),
    ):
        with instance(fmu, "CoSimulation") as made:
            with pytest.raises(Exception, match=r"fmi[23]Set(Real|Float64)"):
                made.write({name: value})
            assert told in capsys.readouterr().out


def test_values_without_a_network_are_refused_at_the_start(
    tmp_path: Path, version: Literal["2.0", "3.0"], capsys: pytest.CaptureFixture[str]
):
    """`R_Tfx1` of paper-2024 has no bounds; a negative resistance has no meaning."""
    fmu = export_fmu(Twin("paper-2024"), tmp_path / "a.fmu", version=version)
    with instance(fmu, "CoSimulation") as made:
        made.write({"R_Tfx1": -0.3})
        with pytest.raises(Exception, match="ExitInitializationMode"):
            made.initialize()
        told = "parameters: expected values with which all thermal resistances are above 0"
        assert told in capsys.readouterr().out
        made.write({"R_Tfx1": 0.3})
        made.exitInitializationMode()


def test_steps_that_would_not_be_stable_are_refused_as_in_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Sides that are light and far from the plate; model exchange has no steps."""
    values = {"C_side": 1.0, "R_pc": 5.0, "R_ph": 5.0, "alpha": 0.1, "R_E": 0.2}
    twin = Twin("single-cell")
    with pytest.raises(SimulationError, match="expected steps with a stability number"):
        Stepper(twin.with_values(values), 1.0)
    fmu = export_fmu(twin, tmp_path / "a.fmu")
    with instance(fmu, "CoSimulation") as made:
        made.write(values)
        with pytest.raises(Exception, match="ExitInitializationMode"):
            made.initialize()
    assert "parameters: expected values with which the steps of the FMU" in capsys.readouterr().out
    with instance(fmu, "ModelExchange") as made:
        made.write(values)
        made.initialize()


def test_a_parameter_with_the_name_of_a_channel_has_a_longer_one(tmp_path: Path):
    twin = Twin(heated_box(('"T_air"', '"R_film"')))
    fmu = export_fmu(twin, tmp_path / "a.fmu", compiler=None)
    assert fmu.outputs == ("R_film", "T_wall")
    assert fmu.parameters == ("P", "parameter.R_film")
