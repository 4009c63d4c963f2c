"""The C sources, compiled for this machine, beside the model in Python."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiled_c import compiled, ran

from jaxtwin import Twin, linearize
from jaxtwin.c_export import export_c
from jaxtwin.control import StateSpace
from jaxtwin.errors import ControlError

MAIN = """
#include <stdio.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static %(real)s duty[MODEL_INPUTS], temperatures[MODEL_OUTPUTS];
    double value;
    int i, n = 0;
    model_init(&state);
    while (scanf("%%lf", &value) == 1) {
        duty[n++] = (%(real)s)value;
        if (n < MODEL_INPUTS) {
            continue;
        }
        n = 0;
        model_output(&state, duty, temperatures);
        for (i = 0; i < MODEL_OUTPUTS; ++i) {
            printf("%%.17g ", (double)temperatures[i]);
        }
        printf("\\n");
        model_step(&state, duty);
    }
    return 0;
}
"""

pytestmark = pytest.mark.c_compiler


def an_hour(inputs: int, sample_time: float) -> np.ndarray:
    """Steps of every size and sign, a minute each, on top of duty cycles about the middle."""
    steps = np.random.default_rng(0).uniform(-1, 1, (60, inputs))
    return np.repeat(steps, round(60 / sample_time), axis=0)


def of_the_paper() -> StateSpace:
    """Two cells with a lag and a delay that is no multiple of the sample time."""
    twin = Twin("dual-cell", {"t_delay": 2.4})
    return linearize(twin, duty=[0.4, 0.3]).discretise(1.0)


def reduced() -> StateSpace:
    return linearize(Twin("dual-cell"), duty=[0.4, 0.3]).reduce(6).discretise(0.5)


def small() -> StateSpace:
    """With a direct gain, behind a delay of a single step, and no lag."""
    return StateSpace([[-0.1]], [[1.0]], [[2.0]], [[0.5]], delay_s=1.0).discretise(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "precision"),
    [
        (of_the_paper, "double"),
        (reduced, "double"),
        (small, "double"),
        (small, "float"),
        pytest.param(of_the_paper, "float", marks=pytest.mark.long),
        pytest.param(reduced, "float", marks=pytest.mark.long),
    ],
)
def test_an_hour_in_c_is_the_hour_in_python(make, precision, tmp_path: Path):
    """To 1e-12 of the largest temperature in double, within 0.01 K in float."""
    model = make()
    sources = export_c(
        model, tmp_path / "code", precision=precision, origin="dual-cell, as bundled"
    )
    duty = an_hour(len(model.input_names), model.sample_time_s)
    if precision == "float":
        duty = duty.astype(np.float32).astype(float)
    found, expected = ran(compiled(sources, MAIN % {"real": precision}), duty), model.simulate(duty)
    assert found.shape == expected.shape
    allowed = 0.01 if precision == "float" else 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=allowed)


def test_the_header_says_what_goes_in_and_out(tmp_path: Path):
    model = of_the_paper()
    header = export_c(model, tmp_path, origin="fit.toml of 2026-11-22").header.read_text()
    assert "fit.toml of 2026-11-22" in header
    assert "Sample time: 1.0 s. Numbers: double." in header
    assert re.search(r"0: P1 \(0\.4\)", header)
    assert all(f": {name} (" in header for name in model.output_names)
    assert f"#define MODEL_STATES {len(model.A)}" in header


def test_sizes_are_those_of_the_compiler(tmp_path: Path):
    model = reduced()
    sources = export_c(model, tmp_path, precision="float", name="plate")
    text = '#include "plate.c"\n#include <stdio.h>\nint main(void) {\n'
    tables = re.findall(r"static const float (\w+)", sources.numbers.read_text())
    total = " + ".join(f"sizeof {name}" for name in tables)
    text += f'printf("%u %u", (unsigned)({total}), (unsigned)sizeof(plate_state)); return 0; }}\n'
    (tmp_path / "main.c").write_text(text)
    command = ["cc", str(tmp_path / "main.c"), "-o", str(tmp_path / "program")]
    subprocess.run(command, check=True)
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert done.stdout == f"{sources.coefficient_bytes} {sources.state_bytes}"


def test_comments_hold_no_end_of_a_comment(tmp_path: Path):
    sources = export_c(small(), tmp_path, origin="a */ b\nc ??/ ü")
    compiled(sources, MAIN % {"real": "double"})


def test_what_c_cannot_say_is_refused(tmp_path: Path):
    with pytest.raises(ControlError, match="name: expected letters"):
        export_c(small(), tmp_path, name="2 cells")
    large = StateSpace([[-0.1]], [[1e300]], [[1.0]], [[0.0]]).discretise(1.0)
    with pytest.raises(ControlError, match="model_B: expected finite numbers in float, got 9"):
        export_c(large, tmp_path / "none", precision="float")
    assert not (tmp_path / "none").exists()


def test_files_that_cannot_be_written_are_refused(tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ControlError, match=r"folder: .*file: cannot be made"):
        export_c(small(), tmp_path / "file")
    with pytest.raises(ControlError, match="a path whose names are not too long"):
        export_c(small(), tmp_path, name="x" * 300)
    (tmp_path / "model.c").mkdir()
    with pytest.raises(ControlError, match=r"model\.c: cannot be written"):
        export_c(small(), tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "file",
        "model.c",
        "model.h",
        "model_numbers.h",
    ]
