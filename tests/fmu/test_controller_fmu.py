"""An FMU of a controller, run by fmpy, beside the controller in Python."""

from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import numpy as np
import pytest

from jaxtwin import Twin, export_fmu, linearize
from jaxtwin.control import MPC, PID, AbstractController, GainScheduled, design_mpc
from jaxtwin.errors import ControlError

pytestmark = [pytest.mark.c_compiler, pytest.mark.fmpy, pytest.mark.usefixtures("float64")]

SECONDS = 40

# The duty that is taken over.
BEFORE = np.array([0.2, 0.4])


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


def pid() -> PID:
    return PID(0.05, 0.001, 0.2, 2.0, measured=[["T1", "T2"], "T2"], limits=(0, 1), sample_time_s=2)


def mpc(twin: Twin) -> MPC:
    model = linearize(twin, temperatures=40.0).discretise(2.0)
    return design_mpc(model, measured=["T1", "T2"], horizon=4, limits=(0, 1))


def drive() -> np.ndarray:
    """Readings and references that change every second, as fmpy takes inputs."""
    names = ("reference.1", "reference.2", "T1", "T2")
    rows = np.zeros(SECONDS, dtype=[(name, float) for name in ("time", *names)])
    rows["time"] = np.arange(SECONDS)
    random = np.random.default_rng(0)
    for name in names:
        rows[name] = random.uniform(36.0, 44.0, SECONDS)
    return rows


def in_python(controller: AbstractController, twin: Twin) -> np.ndarray:
    """The duty after each second."""
    controller, rows = controller.for_rig(twin.rig), drive()
    weights = controller.reading_weights(twin.channels)
    readings = np.column_stack([rows["T1"], rows["T2"]]) @ weights.T
    references = np.column_stack([rows["reference.1"], rows["reference.2"]])
    state, step, duty = (
        controller.init(BEFORE, readings[0]),
        eqx.filter_jit(controller.step),
        BEFORE,
    )
    found = []
    for second in range(SECONDS):
        if second % controller.sample_time_s == 0:
            duty, state = step(state, references[second], readings[second])
        found.append(np.asarray(duty))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("kind", ["pid", "mpc"])
def test_the_duty_is_that_of_python(
    twin: Twin, tmp_path: Path, version: Literal["2.0", "3.0"], kind: str
):
    """A sample each second step of a second, with the inputs at its beginning."""
    from fmpy import simulate_fmu
    from fmpy.validation import validate_fmu

    controller = pid() if kind == "pid" else mpc(twin)
    fmu = export_fmu(controller, tmp_path / "c.fmu", rig=twin.rig, version=version)
    assert validate_fmu(str(fmu.path)) == []
    assert fmu.inputs == ("reference.1", "reference.2", "T1", "T2")
    assert fmu.outputs == ("duty.H1", "duty.H2")
    rows = drive()
    start: dict[str, Any] = {name: rows[name][0] for name in fmu.inputs}
    start |= {"start_duty.H1": BEFORE[0], "start_duty.H2": BEFORE[1]}
    found = simulate_fmu(
        str(fmu.path), step_size=1.0, output_interval=1.0, stop_time=SECONDS - 1.0,
        input=rows, start_values=start, output=list(fmu.outputs),
    )  # fmt: skip
    duty = np.column_stack([found[name] for name in fmu.outputs])
    np.testing.assert_array_equal(duty[0], BEFORE)
    np.testing.assert_allclose(duty[1:], in_python(controller, twin)[:-1], atol=1e-9)


def test_sources_alone_and_what_is_refused(twin: Twin, tmp_path: Path):
    path = tmp_path / "c.fmu"
    assert export_fmu(pid(), path, rig=twin.rig, compiler=None).binary is None
    with pytest.raises(ControlError, match="export_fmu: rig: expected the rig of the controller"):
        export_fmu(pid(), path)
    with pytest.raises(ControlError, match="step_size: expected None for a controller, which has"):
        export_fmu(pid(), path, rig=twin.rig, step_size=1.0)
    with pytest.raises(ControlError, match="rig: expected None for a twin"):
        export_fmu(twin, path, rig=twin.rig)
    with pytest.raises(ControlError, match="whose class has a law in C, got a GainScheduled"):
        export_fmu(GainScheduled([pid(), pid()], at=[30, 40]), path, rig=twin.rig)
