"""The observer in C beside the extended Kalman filter of Python, over an hour of a virtual run."""

from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import compiled, ran
from heated_box import cell_and_heater
from radiating_rig import radiating_rig

from jaxtwin import Experiment, Stepper, Twin, export_c, simulate
from jaxtwin.errors import ControlError
from jaxtwin.observers import ExtendedKalmanFilter, ProcessNoise, live_observer
from jaxtwin.simulation import reduce_stepper

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static %(real)s row[MODEL_CELLS + MODEL_CHANNELS + 1];
    static %(real)s off[MODEL_CELLS], nodes[MODEL_NODES], spreads[MODEL_NODES];
    double value;
    int i, n = 0, begun = 0;
    while (scanf("%%lf", &value) == 1) {
        row[n++] = (%(real)s)value;
        if (!begun) {
            model_init(&state, row[0], off);
            begun = 1;
            n = 0;
        }
        if (n < MODEL_CELLS + MODEL_CHANNELS + 1) {
            continue;
        }
        n = 0;
        model_predict(&state, row);
        model_correct(&state, row + MODEL_CELLS, row[MODEL_CELLS + MODEL_CHANNELS]);
        model_nodes(&state, nodes);
        model_spreads(&state, spreads);
        for (i = 0; i < MODEL_NODES; ++i) {
            printf("%%.17g %%.17g ", (double)nodes[i], (double)spreads[i]);
        }
        for (i = 0; i < MODEL_STATES; ++i) {
            printf("%%.17g ", (double)state.x[i]);
        }
        printf("\\n");
    }
    return 0;
}
"""


def run_of(twin: Twin, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Duty, readings and ambient of a run; a third of the readings are missing, each by itself, all
    of them for two minutes, and the camera jumps by a kelvin."""
    random = np.random.default_rng(5)
    cells = len(twin.rig.driven)
    lowest = np.array(twin.rig.lowest_duty)
    levels = random.uniform(np.maximum(lowest, -0.3), 0.9, (samples // 60 + 1, cells))
    levels[3] = 0.0
    duty = levels.repeat(60, axis=0)[:samples]
    plan = Experiment(np.arange(float(samples)), duty, ambient=20.0)
    readings = np.asarray(simulate(twin, plan).to_recording(noise=0.1, seed=2).temperatures)
    readings = readings + np.where(np.arange(samples) % 400 < 30, 1.0, 0.0)[:, None]
    readings[1:][random.random(readings[1:].shape) < 0.3] = np.nan
    readings[200:320] = np.nan
    # Rejected: one channel, all of them, and the first samples of a change that lasts.
    readings[400, 0] = 85.0
    readings[450] = -127.0
    readings[500:, -1] += 30.0
    ambient = np.where(random.random(samples) < 0.5, np.nan, 20.0)
    return duty, readings, ambient


def python_of(
    kalman: ExtendedKalmanFilter, duty: np.ndarray, readings: np.ndarray, ambient: np.ndarray
) -> np.ndarray:
    """What the C prints, by Python."""

    def step(state, row):
        u, y, room = row
        state = kalman.predict(state, u, room, kalman.longest_step)
        state = kalman.update(state, y, jnp.isfinite(y), room)
        model = kalman.model
        block = model.layout.of("modes")
        covariance = model.shapes @ state.covariance[block, block] @ model.shapes.T
        spread = jnp.sqrt(jnp.maximum(jnp.diag(covariance), 0.0))
        both = jnp.stack([kalman.nodes(state), spread], axis=1).ravel()
        return state, jnp.concatenate([both, state.mean])

    with jax.enable_x64(True):
        start = kalman.init(float(np.nanmean(readings[0])), np.zeros(duty.shape[1]))
        rows = tuple(map(jnp.asarray, (duty, readings, ambient)))
        return np.asarray(jax.jit(lambda s, r: jax.lax.scan(step, s, r)[1])(start, rows))


def c_of(
    kalman: ExtendedKalmanFilter,
    folder: Path,
    precision: Literal["double", "float"],
    duty: np.ndarray,
    readings: np.ndarray,
    ambient: np.ndarray,
) -> np.ndarray:
    sources = export_c(kalman, folder, precision=precision)
    program = compiled(sources, MAIN % {"real": precision})
    rows = np.column_stack([duty, readings, ambient])
    first = np.full((1, 1), np.nanmean(readings[0]))
    return ran(program, [*first, *rows])  # pyright: ignore[reportArgumentType]


OBSERVERS = {
    "lag, delay, losses, a camera": (Twin("dual-cell"), None, 1.0),
    "mean voltage, no lag, no delay": (Twin("paper-2024"), None, 2.0),
    "a single cell": (Twin("single-cell"), ProcessNoise(disturbance=2.0, room=0.01), 1.0),
    "heaters without a plate": (Twin("tclab"), None, 1.0),
    "cell and heaters": (Twin(cell_and_heater("on-off")), None, 1.0),
}

# Those that the other ones contain.
SIMILAR = ("mean voltage, no lag, no delay", "a single cell")


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.long if kind in SIMILAR else ()) for kind in OBSERVERS],
)
def test_the_observer_in_c_estimates_what_python_does(kind: str, tmp_path: Path):
    twin, noise, sample_time = OBSERVERS[kind]
    kalman = live_observer(twin, noise, sample_time)
    samples = 3600 if kind == "lag, delay, losses, a camera" else 600
    duty, readings, ambient = run_of(twin, samples)
    expected = python_of(kalman, duty, readings, ambient)
    found = c_of(kalman, tmp_path, "double", duty, readings, ambient)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.long
@pytest.mark.c_compiler
def test_with_twelve_modes_and_in_float_it_estimates_the_same_within_the_band(tmp_path: Path):
    """C against Python with the same modes in double; in float against that."""
    twin = Twin("dual-cell")
    levels = np.random.default_rng(0).uniform(-0.3, 1.0, (20, 2))
    small = reduce_stepper(Stepper(twin, 1.0), 12, levels.repeat(60, axis=0))
    kalman = live_observer(twin, None, 1.0, stepper=small)
    rows = run_of(twin, 600)
    expected = python_of(kalman, *rows)
    found = c_of(kalman, tmp_path / "double", "double", *rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    rounded = c_of(kalman, tmp_path / "float", "float", *rows)
    nodes, spreads = expected[:, 0:60:2], expected[:, 1:60:2]
    assert np.abs(rounded[:, 0:60:2] - nodes).max() < 0.02
    np.testing.assert_allclose(rounded[:, 1:60:2], spreads, atol=0.02)
    whole = python_of(live_observer(twin), *rows)
    late = slice(300, None)
    assert np.all(np.abs(whole[late, 0:60:2] - nodes[late]) < 3 * whole[late, 1:60:2])


def test_an_observer_with_uncertain_values_or_other_inputs_is_refused(tmp_path: Path):
    drifting = live_observer(Twin("dual-cell"), ProcessNoise(names=("R_E",)))
    with pytest.raises(ControlError, match=r"exact values.*noise without names"):
        export_c(drifting, tmp_path)
    box = live_observer(Twin("heated-box"))
    with pytest.raises(ControlError, match=r"a rig without other inputs, got one of heated-box"):
        export_c(box, tmp_path)


def test_an_observer_of_a_rig_with_nonlinear_links_is_refused(tmp_path: Path):
    with pytest.raises(ControlError, match=r"expected an observer .* links are resistances"):
        export_c(live_observer(Twin(radiating_rig())), tmp_path)
