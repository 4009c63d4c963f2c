"""A twin in C, nonlinear as it is, beside its steps in Python."""

import re
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import numpy as np
import pytest
from compiled_c import compiled, ran
from hand_rig import rig_of_many_parts
from heated_box import cell_and_heater, heated_box

from jaxtwin import ControlError, Experiment, Stepper, Twin, simulate
from jaxtwin.c_export import export_c
from jaxtwin.simulation import reduce_stepper

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static %(real)s row[MODEL_CELLS + 1], nodes[MODEL_NODES], readings[MODEL_CHANNELS];
    static %(real)s off[MODEL_CELLS];
    double value;
    int i, n = 0, begun = 0;
    while (scanf("%%lf", &value) == 1) {
        if (!begun) {
            nodes[n++] = (%(real)s)value;
            if (n == MODEL_NODES) {
                model_init(&state, nodes, off);
                begun = 1;
                n = 0;
            }
            continue;
        }
        row[n++] = (%(real)s)value;
        if (n < MODEL_CELLS + 1) {
            continue;
        }
        n = 0;
        model_step(&state, row, row[MODEL_CELLS]);
        model_output(&state, row[MODEL_CELLS], readings);
        model_nodes(&state, nodes);
        for (i = 0; i < MODEL_CHANNELS; ++i) {
            printf("%%.17g ", (double)readings[i]);
        }
        for (i = 0; i < MODEL_NODES; ++i) {
            printf("%%.17g ", (double)nodes[i]);
        }
        printf("\\n");
    }
    return 0;
}
"""

TWINS = {
    "losses that are not linear, a lag, a delay of whole steps": Twin("dual-cell"),
    "a delay of no whole steps": Twin("dual-cell", {"t_delay": 1.37}),
    "mean voltage, no lag, no delay": Twin("paper-2024"),
    "a single cell": Twin("single-cell"),
    "many parts": Twin(rig_of_many_parts("on-off")),
    "many parts, mean voltage": Twin(rig_of_many_parts("voltage")),
    "heaters without a plate": Twin(heated_box()),
    "cell and heaters": Twin(cell_and_heater("on-off")),
    "cell and heaters, mean voltage": Twin(cell_and_heater("voltage")),
}

PRECISIONS: tuple[Literal["double", "float"], ...] = ("double", "float")

pytestmark = pytest.mark.c_compiler


def an_hour(cells: int, room: float) -> np.ndarray:
    """Steps of every size and sign, a minute each, and a room that warms up by 3 K."""
    random = np.random.default_rng(0)
    duty = np.repeat(random.uniform(-0.6, 1.0, (60, cells)), 60, axis=0)
    return np.column_stack([duty, room + np.linspace(0, 3, len(duty)).round(3)])


def in_python(stepper: Stepper, rows: np.ndarray) -> np.ndarray:
    def step(state, row):
        state = stepper.step(state, row[:-1], row[-1])
        readings = stepper.channels(state, row[-1])
        return state, jax.numpy.concatenate([readings, state.nodes])

    with jax.enable_x64(True):
        start = jax.tree.map(jax.numpy.asarray, stepper.start())
        return np.asarray(jax.jit(lambda rows: jax.lax.scan(step, start, rows)[1])(rows))


def allowed(precision: Literal["double", "float"], expected: np.ndarray) -> float:
    """How far C may be from Python, K."""
    return 0.01 if precision == "float" else 1e-12 * float(np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("key", TWINS)
def test_an_hour_in_c_is_the_hour_in_python(key: str, tmp_path: Path):
    """To 1e-12 of the largest temperature in double, within 0.01 K in float."""
    stepper = Stepper(TWINS[key], 1.0)
    rows = an_hour(len(stepper.system.wiring.cold), float(stepper.ambient))
    rows = rows.astype(np.float32).astype(float)
    rows[:, :-1] = np.maximum(rows[:, :-1], stepper.system.wiring.lowest_duty)
    expected = in_python(stepper, rows)
    start = np.asarray(stepper.start().nodes)
    for precision in PRECISIONS:
        found = in_c(stepper, tmp_path / precision, precision, start, rows)
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, rtol=0, atol=allowed(precision, expected))


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_reduced_twin_in_c_is_that_in_python(
    precision: Literal["double", "float"], tmp_path: Path
):
    """Twelve of thirty modes over an hour: to 1e-12 of the largest temperature in double, within
    0.01 K in float."""
    whole = Stepper(TWINS["losses that are not linear, a lag, a delay of whole steps"], 1.0)
    rows = an_hour(2, float(whole.ambient)).astype(np.float32).astype(float)
    stepper = reduce_stepper(whole, 12, rows[:, :-1])
    start = np.asarray(stepper.start().nodes)
    expected = in_python(stepper, rows)
    found = in_c(stepper, tmp_path, precision, start, rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=allowed(precision, expected))
    assert "#define MODEL_MODES 12\n" in (tmp_path / "model.h").read_text()


def in_c(
    stepper: Stepper,
    folder: Path,
    precision: Literal["double", "float"],
    start: np.ndarray,
    rows: np.ndarray,
) -> np.ndarray:
    program = compiled(export_c(stepper, folder, precision=precision), MAIN % {"real": precision})
    return ran(program, np.concatenate([start, rows.ravel()])[:, None])


@pytest.mark.slow
def test_the_twin_in_c_is_that_of_simulate(tmp_path: Path):
    """Under the steps of the paper's recordings, to the error of steps of a second."""
    twin = Twin("dual-cell")
    stepper = Stepper(twin, 1.0)
    time = np.arange(601.0)
    duty = np.where(time < 300, 0.5, 0.78)[:, None] * np.ones(2)
    expected = simulate(twin, Experiment(time, duty))
    rows = np.column_stack([duty[:-1], np.full(600, float(stepper.ambient))])
    found = in_c(stepper, tmp_path, "double", np.asarray(stepper.start().nodes), rows)
    temperatures = np.hstack([expected.temperatures, expected.states])
    np.testing.assert_allclose(found, temperatures[1:], rtol=0, atol=5e-3)


def test_the_header_says_what_goes_in_and_out(tmp_path: Path):
    twin = Twin("dual-cell")
    sources = export_c(Stepper(twin, 0.5), tmp_path, name="plate", origin="fit.toml of 2026-11-22")
    header = sources.header.read_text()
    assert "fit.toml of 2026-11-22" in header
    assert "Sample time: 0.5 s. Numbers: double." in header
    assert re.search(r"0: P1\n", header)
    assert all(f": {channel}\n" in header for channel in twin.channels)
    assert all(f": {node.name}\n" in header for node in twin.netlist.nodes)
    assert f"#define PLATE_MODES {len(twin.netlist.nodes)}" in header


def test_half_a_step_of_a_second_is_a_step_of_half_a_second(tmp_path: Path):
    """The modes decay as much in two steps of half a second as in one of a second."""
    remaining: dict[tuple[float, str], np.ndarray] = {}
    for step in (0.5, 1.0):
        source = export_c(Stepper(Twin("single-cell"), step), tmp_path / f"{step}").numbers
        for part in ("half_decay", "decay"):
            found = re.search(rf"model_{part}\[1\]\[\d+\] = {{\s*{{(.*?)}}", source.read_text())
            assert found is not None
            remaining[step, part] = 1 + np.array(found[1].split(","), float)
    np.testing.assert_allclose(remaining[1.0, "half_decay"], remaining[0.5, "decay"])
    np.testing.assert_allclose(remaining[1.0, "decay"], remaining[0.5, "decay"] ** 2)
    np.testing.assert_allclose(remaining[0.5, "decay"], remaining[0.5, "half_decay"] ** 2)


def test_numbers_that_a_float_does_not_have_are_refused(tmp_path: Path):
    stepper = Stepper(Twin("single-cell"), 1.0)
    large = eqx.tree_at(lambda s: s.system.gain, stepper, np.asarray(stepper.system.gain) * 1e300)
    with pytest.raises(ControlError, match="model_by_modes: expected finite numbers in float, got"):
        export_c(large, tmp_path / "none", precision="float")
    assert not (tmp_path / "none").exists()
