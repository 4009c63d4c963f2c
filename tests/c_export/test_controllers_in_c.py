"""Controllers in C, beside those in Python: what they ask for, and when they switch off."""

import subprocess
from functools import cache
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import compiled, ran
from exported_controllers import CONTROLLERS, COSTS, KEYS, LEFT, RIGHT, c_of, controller_of

from jaxtwin import Twin, simulate_closed_loop
from jaxtwin.c_export import CSources, export_c
from jaxtwin.control import (
    PID,
    DecoupledPI,
    Relay,
    StateSpace,
    design_lqi,
    design_mpc,
)
from jaxtwin.errors import ControlError

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static %(real)s duty[MODEL_CELLS], row[MODEL_OUTPUTS + MODEL_READINGS];
    double value;
    int i, n = 0, begun = 0;
    while (scanf("%%lf", &value) == 1) {
        row[n] = (%(real)s)value;
        if (++n < MODEL_OUTPUTS + MODEL_READINGS) {
            continue;
        }
        n = 0;
        if (!begun) {
            model_init(&state, duty, row + MODEL_OUTPUTS);
            begun = 1;
        }
        model_step(&state, row, row + MODEL_OUTPUTS, duty);
        for (i = 0; i < MODEL_CELLS; ++i) {
            printf("%%.17g ", (double)duty[i]);
        }
        printf("\\n");
    }
    return 0;
}
"""

REFERENCES = "0:35,600:45,1800:30"

pytestmark = pytest.mark.c_compiler


def asked(sources: CSources, reference: np.ndarray, reading: np.ndarray) -> np.ndarray:
    precision = "float" if "Numbers: float" in sources.header.read_text() else "double"
    program = compiled(sources, MAIN % {"real": precision})
    return ran(program, np.hstack([reference, reading]))


@cache
def an_hour(key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """References, readings with NaN where none came, and duty, of a loop with noise and faults.

    For 2 s of each minute none comes, and from 3400 s on a channel that counts reads NaN.
    """
    run = simulate_closed_loop(
        Twin("dual-cell"),
        controller_of(key),
        REFERENCES,
        duration=3600,
        faults="stall=60/2",
        failed_channels={"T11": 3400.0},
        quantised=False,
    )
    readings = np.array(run.loop.measurement)
    readings[1:][(np.diff(readings, axis=0) == 0).all(axis=1)] = np.nan
    return run.reference, readings, run.duty


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("precision", ["double", pytest.param("float", marks=pytest.mark.long)])
def test_an_hour_in_c_is_the_hour_of_the_closed_loop(
    key: str, precision: Literal["double", "float"], tmp_path: Path
):
    """With readings that do not come, to 1e-12 of full duty in double, 1e-5 in float; then off.

    Plans amplify rounding in an hour of a loop: to 3e-12 in double
    (docs/controller-firmware.md). In float the minimum of a plan is as sharp as its cost is: half a
    percent of full duty, and 4 percent along the duty cycles that hold the mean with hardly another
    range.
    """
    reference, readings, duty = an_hour(key)
    found = asked(c_of(controller_of(key), tmp_path, precision), reference, readings)
    missing = np.any(np.isnan(readings), axis=1)
    assert missing[:3400].sum() == 112
    assert missing[3400:].all()
    assert duty[3402].any()
    assert not duty[3403:].any()
    assert found.shape == duty.shape
    in_float = 0.04 if key in COSTS else 5e-3 if key.startswith("plan") else 1e-5
    in_double = 3e-12 if key in COSTS or key.startswith("plan") else 1e-12
    allowed = in_float if precision == "float" else in_double
    np.testing.assert_allclose(found, duty, rtol=0, atol=allowed)


def test_a_slow_integral_does_not_stand_still_in_float(tmp_path: Path):
    """2e-8 a sample on top of 0.5, of which a `float` has steps of 6e-8."""
    controller = PID(0.0, 1e-4, sample_time_s=0.1)
    samples, start = 36000, 0.5 / (1e-4 * 0.1)
    reference = np.full((samples, 1), 20.002)
    reference[0] = 20.0 + start
    found = asked(c_of(controller, tmp_path, "float"), reference, np.full((samples, 1), 20.0))
    error = float(np.float32(20.002)) - 20.0
    assert found[-1, 0] == pytest.approx(0.5 + (samples - 2) * error * 1e-5, abs=1e-6)


def test_cells_are_off_at_once_without_a_reference(tmp_path: Path):
    """And stay off when it comes back."""
    reference = np.array([[30.0], [np.nan], [30.0], [30.0]])
    found = asked(c_of(CONTROLLERS["of the mean"], tmp_path), reference, np.full((4, 1), 25.0))
    assert found[0].all()
    assert not found[1:].any()


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS)
def test_cells_stay_off_where_it_begins_without_a_reading(key: str, tmp_path: Path):
    channels, controller = Twin("dual-cell").channels, controller_of(key)
    outputs = len(controller.output_weights(channels))
    readings = np.full((5, len(controller.reading_weights(channels))), 25.0)
    readings[0] = np.nan
    found = asked(c_of(controller, tmp_path), np.full((5, outputs), 30.0), readings)
    assert not found.any()


def test_a_reading_after_2_s_is_early_enough(tmp_path: Path):
    """It is the same as if the one before had come all the time."""
    controller, reference = CONTROLLERS["of the mean"], np.full((6, 1), 30.0)
    sources = c_of(controller, tmp_path)
    gap = np.array([25.0, np.nan, np.nan, np.nan, 26.0, 26.0])[:, None]
    held = np.array([25.0, 25.0, 25.0, 25.0, 26.0, 26.0])[:, None]
    np.testing.assert_array_equal(asked(sources, reference, gap), asked(sources, reference, held))
    assert asked(sources, reference, gap).all()


@pytest.mark.slow
def test_it_starts_without_a_bump(tmp_path: Path):
    """From the duty that the cells have, in C as in Python."""
    begin = MAIN.replace("model_init(", "duty[0] = 0.3; duty[1] = 0.6; model_init(")
    exact = dict.fromkeys(("of each output", "decoupled", "state feedback"), 1e-14)
    for key, allowed in (exact | {"plan": 1e-7}).items():
        sources = c_of(controller_of(key), tmp_path / key.replace(" ", "-"))
        program = compiled(sources, begin % {"real": "double"})
        watched = [26.0, 27.0] if key == "plan" else []
        rows = np.tile([25.0, 27.0, 25.0, 27.0, *watched], (3, 1))
        np.testing.assert_allclose(ran(program, rows), [[0.3, 0.6]] * 3, atol=allowed)


def test_the_filtered_derivative_is_that_of_python(tmp_path: Path):
    """Of readings that rise and fall steadily; the first output has a filter, the second none."""
    controller = CONTROLLERS["of each output"]
    assert isinstance(controller, PID)
    reading = np.array([25.0, 27.0]) + np.outer(np.arange(8.0), [0.5, -0.2])
    reference = np.full_like(reading, 30.0)
    expected = []
    with jax.enable_x64(True):
        state = controller.init(np.zeros(2), reading[0])
        for target, value in zip(reference, reading, strict=True):
            duty, state = controller.step(state, target, value)
            expected.append(np.asarray(duty))
    found = asked(c_of(controller, tmp_path), reference, reading)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    assert (found > 0).any()


def test_a_controller_for_other_cells_is_refused(tmp_path: Path):
    """Designed for a single cell, with a channel that the rig with two cells has too."""
    model = StateSpace([[-0.1]], [[0.1]], [[1.0]], [[0.0]], output_names=["TAM"]).discretise(1.0)
    for controller in (
        design_lqi(model, measured=["TAM"]),
        design_mpc(model, measured=["TAM"], horizon=2),
    ):
        with pytest.raises(ControlError, match="a controller of the rig's 2 cells, got one"):
            c_of(controller, tmp_path)


def test_the_header_of_a_controller_says_what_it_does(tmp_path: Path):
    rig = Twin("dual-cell").rig
    pid = PID(0.1, 0.001, measured=[LEFT, RIGHT], limits=(0, 1))
    header = export_c(pid, tmp_path, rig=rig, name="pid", origin="pid.toml").header.read_text()
    for line in (
        "pid: a PID for each cell for the rig dual-cell",
        "Parameters: pid.toml",
        "Kp: 0.1 1/K",
        "Ki: 0.001 1/(K s)",
        "Sample time: 1.0 s. Numbers: double.",
        "1: T15, T16, T25, T26",
        "Duty cycles from 0 to 1, positive heats",
        "0: P1",
        "#define PID_SILENCE_S 3.0",
    ):
        assert line in header


@pytest.mark.parametrize("key", KEYS)
def test_sizes_of_a_controller_are_those_of_the_compiler(key: str, tmp_path: Path):
    sources = c_of(controller_of(key), tmp_path, "float")
    main = '#include "model.c"\n#include <stdio.h>\nint main(void) {\n'
    main += 'printf("%u", (unsigned)sizeof(model_state)); return 0; }\n'
    (tmp_path / "main.c").write_text(main)
    program = tmp_path / "program"
    subprocess.run(["cc", str(tmp_path / "main.c"), "-o", str(program), "-lm"], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    assert done.stdout == str(sources.state_bytes)


def test_fast_math_is_refused_by_the_compiler(tmp_path: Path):
    """It would take NaN for a reading."""
    sources = c_of(CONTROLLERS["of the mean"], tmp_path)
    command = ["cc", "-ffast-math", "-c", str(sources.source), "-o", str(tmp_path / "model.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "compile without it" in done.stderr


def test_controllers_that_c_cannot_say_are_refused(tmp_path: Path):
    rig = Twin("dual-cell").rig
    with pytest.raises(ControlError, match="rig: expected the controller's"):
        export_c(PID(0.1), tmp_path)
    with pytest.raises(ControlError, match="whose class has a law in C, got a Relay"):
        export_c(Relay(0.1, 0.4, 0.1), tmp_path, rig=rig)
    with pytest.raises(ControlError, match="an output for each of the 2 cells of dual-cell, got 3"):
        export_c(PID(0.1, measured=["T11", "T12", "T13"]), tmp_path, rig=rig)
    with pytest.raises(ControlError, match="Kp: expected one value, or one for each of the 2"):
        export_c(PID([0.1, 0.1, 0.1]), tmp_path, rig=rig)
    changed = DecoupledPI(
        0.1, 0.0, 0.1, 0.0, measured=[LEFT, RIGHT], decoupling=jnp.array([[1.0, 1.0], [1.0, 1.0]])
    )
    with pytest.raises(ControlError, match="decoupling: expected an invertible matrix"):
        export_c(changed, tmp_path, rig=rig)
    with pytest.raises(ControlError, match="model_Kp: expected finite numbers in float, got 1e"):
        export_c(PID(1e300), tmp_path, rig=rig, precision="float")
