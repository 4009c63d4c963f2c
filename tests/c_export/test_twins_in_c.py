"""A twin in C, nonlinear as it is, beside its steps in Python."""

import re
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import numpy as np
import pytest
from boxes import box, box_table
from compiled_c import compiled, ran
from hand_rig import rig_of_many_parts
from heated_box import cell_and_heater, heated_box
from radiating_rig import radiating_rig

from jaxtwin import Experiment, Stepper, Twin, simulate
from jaxtwin.c_export import export_c
from jaxtwin.errors import ControlError
from jaxtwin.rig import Rig, rig_from_tables
from jaxtwin.simulation import reduce_stepper

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static %(real)s row[MODEL_CELLS + 1 + MODEL_INPUTS];
    static %(real)s nodes[MODEL_NODES], readings[MODEL_CHANNELS];
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
        if (n < MODEL_CELLS + 1 + MODEL_INPUTS) {
            continue;
        }
        n = 0;
#if MODEL_INPUTS > 0
        for (i = 0; i < MODEL_INPUTS; ++i) {
            state.inputs[i] = row[MODEL_CELLS + 1 + i];
        }
#endif
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
    "convection, radiation and a quadratic heater": Twin(radiating_rig()),
}


def box_with_losses() -> Rig:
    """The box, whose plate also loses heat by radiation, behind a driver with delay and lag."""
    table = box_table()
    del table["circuit"]
    table["plate"] |= {"material": "aluminium", "film_coefficient": "10 W/(m^2 K)"}
    table["plate"] |= {"film_exponent": "0.25", "emissivity": "0.8"}
    table["driver"] |= {"delay": "1.4 s", "lag": "2 s"}
    return rig_from_tables(table, "box")


WITH_INPUTS = {
    "a lid, a fan, a supply and a coolant that change": Twin(box()),
    "losses that are not linear": Twin(box_with_losses()),
    "heated-box": Twin("heated-box"),
    "oven": Twin("oven"),
    "water-bath": Twin("water-bath"),
    "battery-pack": Twin("battery-pack"),
}

# The range of an input that is a number; that of the others is 0 to 2.
LEVELS = {"V_supply": (9.0, 14.0), "T_water": (5.0, 50.0), "T_coolant": (5.0, 50.0)}

PRECISIONS: tuple[Literal["double", "float"], ...] = ("double", "float")

pytestmark = pytest.mark.c_compiler


def an_hour(cells: int, room: float) -> np.ndarray:
    """Steps of every size and sign, a minute each, and a room that warms up by 3 K."""
    random = np.random.default_rng(0)
    duty = np.repeat(random.uniform(-0.6, 1.0, (60, cells)), 60, axis=0)
    return np.column_stack([duty, room + np.linspace(0, 3, len(duty)).round(3)])


def inputs_of_an_hour(stepper: Stepper) -> np.ndarray:
    """Lids that open and close and numbers that change, each at times of its own."""
    random = np.random.default_rng(1)
    columns = []
    for one in stepper.system.wiring.inputs:
        changes = np.sort(random.integers(0, 3600, 20))
        low, high = LEVELS.get(one.name, (0.0, 2.0))
        levels = random.uniform(low, high, 21)
        if one.states:
            levels = np.arange(21) % len(one.states)
        columns.append(levels[np.searchsorted(changes, np.arange(3600), side="right")])
    return np.column_stack(columns)


def in_python(stepper: Stepper, rows: np.ndarray) -> np.ndarray:
    inputs = [one.name for one in stepper.system.wiring.inputs]
    cells = len(stepper.system.wiring.cold)

    def step(state, row):
        held = dict(zip(inputs, row[cells + 1 :], strict=True))
        state = stepper.step(state, row[:cells], row[cells], inputs=held)
        readings = stepper.channels(state, row[cells])
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
@pytest.mark.parametrize("key", WITH_INPUTS)
def test_an_hour_in_which_inputs_change_is_the_hour_in_python(key: str, tmp_path: Path):
    """To 1e-12 of the largest temperature in double, within 0.01 K in float."""
    stepper = Stepper(WITH_INPUTS[key], 1.0)
    rows = an_hour(len(stepper.system.wiring.cold), float(stepper.ambient))
    rows[:, :-1] = np.maximum(rows[:, :-1], stepper.system.wiring.lowest_duty)
    rows = np.column_stack([rows, inputs_of_an_hour(stepper)]).astype(np.float32).astype(float)
    expected = in_python(stepper, rows)
    start = np.asarray(stepper.start().nodes)
    for precision in PRECISIONS:
        found = in_c(stepper, tmp_path / precision, precision, start, rows)
        np.testing.assert_allclose(found, expected, rtol=0, atol=allowed(precision, expected))


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["heated-box", "oven", "battery-pack"])
def test_inputs_in_c_are_those_of_simulate(rig: str, tmp_path: Path):
    """To the error of steps of a second; `simulate` takes others, in the modes of each regime."""
    twin = Twin(rig)
    stepper = Stepper(twin, 1.0)
    inputs = twin.rig.inputs
    levels = inputs_of_an_hour(stepper)[:1800]
    time, cells = np.arange(1800.0), len(twin.rig.driven)
    duty = np.where(time < 900, 0.6, 0.2)[:, None] * np.ones(cells)
    experiment = Experiment(time, duty).with_inputs(
        **{one.name: column for one, column in zip(inputs, levels.T, strict=True)}
    )
    expected = simulate(twin, experiment)
    rows = np.column_stack([duty, np.full(1800, float(stepper.ambient)), levels])[:-1]
    found = in_c(stepper, tmp_path, "double", np.asarray(stepper.start().nodes), rows)
    temperatures = np.hstack([expected.temperatures, expected.states])
    np.testing.assert_allclose(found, temperatures[1:], rtol=0, atol=5e-5)


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


def test_the_header_says_which_inputs_there_are(tmp_path: Path):
    header = export_c(Stepper(Twin(box()), 1.0), tmp_path).header.read_text()
    for line in ("0: lid, 0 closed, 1 open (0)", "1: fan (1)", "3: T_water, degC (20)"):
        assert f" {line}\n" in header


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
