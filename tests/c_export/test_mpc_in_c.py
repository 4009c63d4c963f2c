"""An MPC in C: references that are known before, and a plate that its `float` heats."""

from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import compiled, ran

from jaxtwin import Stepper, Twin, linearize
from jaxtwin.c_export import export_c
from jaxtwin.control import StateSpace, design_mpc

LEFT, RIGHT = ["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]

AHEAD = """
#include <stdio.h>
#include "model.h"

#define COMING (MODEL_HORIZON * MODEL_OUTPUTS)

int main(void)
{
    static model_state state;
    static double duty[MODEL_CELLS], row[COMING + MODEL_READINGS];
    int i, n = 0, begun = 0;
    while (scanf("%lf", &row[n]) == 1) {
        if (++n < COMING + MODEL_READINGS) {
            continue;
        }
        n = 0;
        if (!begun) {
            model_init(&state, duty, row + COMING);
            begun = 1;
        }
        model_step_ahead(&state, row, row + COMING, duty);
        for (i = 0; i < MODEL_CELLS; ++i) {
            printf("%.17g ", duty[i]);
        }
        printf("\\n");
    }
    return 0;
}
"""

LOOP = """
#include <stdio.h>
#include "model.h"
#include "../plate/plate.c"

int main(void)
{
    static model_state state;
    static plate_state plate;
    static double nodes[PLATE_NODES], duty[PLATE_CELLS], room, reference, readings[PLATE_CHANNELS];
    static const double weights[MODEL_READINGS][PLATE_CHANNELS] = {%(weights)s};
    static %(real)s asked[MODEL_CELLS], wanted[MODEL_OUTPUTS], seen[MODEL_READINGS];
    int i, j, begun = 0;
    while (scanf("%%lf %%lf", &room, &reference) == 2) {
        if (!begun) {
            for (i = 0; i < PLATE_NODES; ++i) {
                nodes[i] = room;
            }
            plate_init(&plate, nodes, duty);
        }
        plate_output(&plate, room, readings);
        for (i = 0; i < MODEL_READINGS; ++i) {
            double sum = 0.0;
            for (j = 0; j < PLATE_CHANNELS; ++j) {
                sum += weights[i][j] * readings[j];
            }
            seen[i] = (%(real)s)sum;
            if (i < MODEL_OUTPUTS) {
                wanted[i] = (%(real)s)reference;
                printf("%%.17g ", sum);
            }
        }
        if (!begun) {
            model_init(&state, asked, seen);
            begun = 1;
        }
        model_step(&state, wanted, seen, asked);
        for (i = 0; i < MODEL_CELLS; ++i) {
            duty[i] = (double)asked[i];
        }
        printf("\\n");
        plate_step(&plate, duty, room);
    }
    return 0;
}
"""

pytestmark = pytest.mark.c_compiler


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell")


def model(twin: Twin) -> StateSpace:
    return linearize(twin, duty=[0.4, 0.3]).reduce(4).discretise(1.0)


@pytest.mark.slow
def test_references_that_are_known_before_give_the_duty_of_python(twin: Twin, tmp_path: Path):
    """A step that comes after 15 samples, and noise, to 1e-12 of full duty."""
    limits: Any = {"T11": (0, 33), "T26": (30, 90, 0.5)}
    mpc = design_mpc(
        model(twin),
        measured=[LEFT, RIGHT],
        horizon=6,
        limits=(0, 1),
        rate_limit=0.1,
        temperature_limits=limits,
    ).for_rig(twin.rig)
    random = np.random.default_rng(0)
    wanted = np.where(np.arange(36)[:, None] < 15, [22.0, 22.0], [36.0, 31.0])
    coming = np.stack([wanted[n : n + 6] for n in range(30)])
    seen = wanted[:30, [0, 1, 0, 1]] - 2.0 + 0.1 * random.normal(size=(30, 4))
    with jax.enable_x64(True):
        step = jax.jit(lambda state, r, y: mpc.step(state, r, y))
        state = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), seen[0]))
        expected = []
        for reference, reading in zip(coming, seen, strict=True):
            duty, state = step(state, reference, reading)
            expected.append(np.asarray(duty))
    sources = export_c(mpc, tmp_path, rig=twin.rig)
    found = ran(compiled(sources, AHEAD), np.hstack([coming.reshape(30, -1), seen]))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert np.ptp(found, axis=0).min() > 0.1


def test_cells_are_off_where_a_reference_to_come_is_not_finite(twin: Twin, tmp_path: Path):
    """At once, and until it is started anew."""
    mpc = design_mpc(model(twin), measured=[LEFT, RIGHT], horizon=3, limits=(0, 1))
    rows = np.tile([30.0] * 6 + [25.0, 25.0], (4, 1))
    rows[1, 5] = np.nan
    found = ran(compiled(export_c(mpc, tmp_path, rig=twin.rig), AHEAD), rows)
    assert found[0].all()
    assert not found[1:].any()


@pytest.mark.slow
def test_a_plate_under_control_in_float_is_that_in_double_to_10_mk(twin: Twin, tmp_path: Path):
    """An hour on the nonlinear twin, with a temperature limit that is reached for 20 minutes."""
    limits: Any = {"T11": (0, 40)}
    mpc = design_mpc(
        model(twin),
        measured=[LEFT, RIGHT],
        limits=(0, 1),
        rate_limit=0.05,
        temperature_limits=limits,
    )
    with jax.enable_x64(True):
        export_c(Stepper(twin, 1.0), tmp_path / "plate", name="plate")
    reference = np.repeat([35.0, 45.0, 30.0], [600, 1200, 1800])
    rows = np.column_stack([np.full(3600, 20.0), reference])

    weights = mpc.reading_weights(twin.channels)
    written = ", ".join("{" + ", ".join(map(str, row)) + "}" for row in weights)

    def outputs(precision: Literal["double", "float"]) -> np.ndarray:
        sources = export_c(mpc, tmp_path / precision, rig=twin.rig, precision=precision)
        return ran(compiled(sources, LOOP % {"real": precision, "weights": written}), rows)

    in_double, in_float = outputs("double"), outputs("float")
    np.testing.assert_allclose(in_float, in_double, rtol=0, atol=0.01)
    np.testing.assert_allclose(in_double[590], [35.0, 35.0], atol=0.02)
    assert in_double[1790, 0] < 41.0
