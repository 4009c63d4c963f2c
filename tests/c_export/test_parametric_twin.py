"""The C that computes a twin from its parameters, over the whole of their bounds."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from radiating_rig import radiating_rig

from jaxtwin import Stepper, Twin
from jaxtwin.c_export._parametric_twin_c import parametric_twin_c, settable_parameters
from jaxtwin.errors import SimulationError
from jaxtwin.rig import Parameter, Rig

pytestmark = [pytest.mark.c_compiler, pytest.mark.usefixtures("float64")]

DRAWS, STEPS = 12, 30

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_numbers numbers;
    static model_state state;
    static double values[MODEL_PARAMETERS], nodes[MODEL_NODES], duty[MODEL_CELLS];
    int i, step;
    for (i = 0; i < MODEL_CELLS; ++i) {
        duty[i] = 0.4 + 0.1 * i;
    }
    for (;;) {
        const char *problem;
        for (i = 0; i < MODEL_PARAMETERS; ++i) {
            if (scanf("%lf", &values[i]) != 1) {
                return 0;
            }
        }
        problem = model_prepare(&numbers, values);
        if (problem != NULL) {
            puts(problem);
            return 1;
        }
        state.numbers = &numbers;
        for (i = 0; i < MODEL_NODES; ++i) {
            nodes[i] = 20.0;
        }
        model_init(&state, nodes, duty);
        for (step = 0; step < STEPS; ++step) {
            model_step(&state, duty, 20.0);
        }
        model_nodes(&state, nodes);
        printf("%d", numbers.is_stable);
        for (i = 0; i < MODEL_NODES; ++i) {
            printf(" %.17g", nodes[i]);
        }
        printf("\\n");
    }
}
"""


def draw(row: Parameter, random: np.random.Generator) -> float:
    if row.lower > 0:
        drawn = np.exp(random.uniform(np.log(row.lower), np.log(row.upper)))
        return float(np.clip(drawn, row.lower, row.upper))
    return float(random.uniform(row.lower, row.upper))


@pytest.mark.slow
@pytest.mark.parametrize(
    "rig",
    ["dual-cell", "single-cell", "heated-box", "battery-pack", radiating_rig()],
    ids=lambda rig: rig if isinstance(rig, str) else rig.name,
)
def test_draws_between_all_bounds_are_the_twin_and_sanitizers_are_silent(
    rig: str | Rig, tmp_path: Path
):
    """Also whether steps of a second are stable is said as in Python."""
    twin = Twin(rig)
    rows = settable_parameters(twin)
    code = parametric_twin_c(twin, Stepper(twin, 1.0), "model", "", rows)
    (tmp_path / "model.h").write_text(code.header)
    (tmp_path / "model_numbers.h").write_text(code.numbers)
    (tmp_path / "model.c").write_text(code.source)
    (tmp_path / "main.c").write_text(MAIN)
    command = ["cc", "-std=c99", "-g", "-O1", f"-DSTEPS={STEPS}", "model.c", "main.c", "-o", "run"]
    command += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    random = np.random.default_rng(0)
    drawn = [{row.name: draw(row, random) for row in rows} for _ in range(DRAWS)]
    text = "\n".join(" ".join(map(repr, values.values())) for values in drawn)
    done = subprocess.run(
        [tmp_path / "run"], input=text, capture_output=True, text=True, check=False
    )
    assert not done.returncode, done.stdout + done.stderr
    found = np.array([line.split() for line in done.stdout.splitlines()], float)
    assert len(found) == DRAWS
    duty = 0.4 + 0.1 * np.arange(len(twin.rig.driven))
    for values, (is_stable, *nodes) in zip(drawn, found, strict=True):
        try:
            stepper = Stepper(twin.with_values(values), 1.0)
        except SimulationError:
            assert not is_stable
            continue
        assert is_stable
        state = stepper.step(stepper.start(20.0, duty), duty, 20.0, steps=STEPS)
        np.testing.assert_allclose(nodes, state.nodes, rtol=0, atol=1e-9)
