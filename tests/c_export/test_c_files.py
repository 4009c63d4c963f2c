"""The C files of the package are C as they stand, before a name is put into them."""

import subprocess
from pathlib import Path

import pytest
from exported_controllers import KEYS, c_of, controller_of

from jaxtwin import Stepper, Twin, control, fmu, linearize, physics
from jaxtwin.c_export import _sources, export_c

LAWS = Path(control.__file__).parent / "controllers" / "laws"
HEAT_LAWS = Path(physics.__file__).parent / "laws"

FILES = sorted(
    file
    for folder in (_sources.FOLDER, LAWS, HEAT_LAWS, Path(fmu.__file__).parent)
    for file in folder.iterdir()
    if file.suffix in (".c", ".h")
)

WARNINGS = (
    "all extra shadow undef cast-qual conversion double-promotion strict-prototypes "
    "missing-prototypes"
)
STRICT = ["-std=c99", "-pedantic", "-Werror", "-fsyntax-only"]
STRICT += [f"-W{name}" for name in WARNINGS.split()]

LAW_FILES = {
    "of the mean": "pid.c",
    "of each output": "pid.c",
    "clamped": "pid.c",
    "proportional": "pid.c",
    "decoupled": "decoupled_pi.c",
    "state feedback": "lqi.c",
    "state feedback of the mean": "lqi.c",
    "plan": "mpc.c",
    "plan of the mean": "mpc.c",
    "plan of the range": "mpc.c",
    "plan of the worst point": "mpc.c",
    "plan of the squares": "mpc.c",
}


def compile_strictly(file: Path, *folders: Path) -> None:
    options = [word for folder in folders for word in ("-I", str(folder))]
    done = subprocess.run(
        ["cc", *STRICT, *options, str(file)], capture_output=True, text=True, check=False
    )
    assert not done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_controller_compiles_with_its_law(key: str, precision, tmp_path: Path):
    c_of(controller_of(key), tmp_path, precision)
    (tmp_path / "law.c").write_text(f'#include "{LAW_FILES[key]}"\n')
    compile_strictly(_sources.FOLDER / "controller.c", tmp_path, LAWS)
    compile_strictly(tmp_path / "model.c")


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize("rig", ["dual-cell", "paper-2024", "single-cell", "oven", "battery-pack"])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_twin_compiles(rig: str, precision, tmp_path: Path):
    export_c(Stepper(Twin(rig), 1.0), tmp_path, precision=precision)
    compile_strictly(_sources.FOLDER / "twin.c", tmp_path)
    compile_strictly(tmp_path / "model.c")


@pytest.mark.c_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_linear_model_compiles(precision, tmp_path: Path):
    model = linearize(Twin("dual-cell"), duty=[0.4, 0.3]).reduce(4).discretise(1.0)
    export_c(model, tmp_path, precision=precision)
    compile_strictly(_sources.FOLDER / "linear_model.c", tmp_path)
    compile_strictly(tmp_path / "model.c")


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_lines_are_plain_and_short(file: Path):
    """ASCII, no tabs, no spaces at the end, at most 100 characters."""
    text = file.read_text(encoding="ascii")
    for line in text.splitlines():
        assert "\t" not in line
        assert line == line.rstrip()
        assert len(line) <= 100
    assert text.endswith("\n")
    assert not text.endswith("\n\n")
