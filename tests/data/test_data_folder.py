"""The data files are one folder, which is found in a checkout and in an installed wheel."""

import shutil
import subprocess
import sys
from pathlib import Path

import jaxtwin
from jaxtwin.data import data_folder

CHECKOUT = Path(__file__).parents[2]
FOLDERS = {"rigs", "modules", "materials", "tables", "recordings"}


def test_the_data_files_are_those_at_the_top_of_the_checkout():
    assert data_folder() == CHECKOUT / "data"
    assert {path.name for path in data_folder().iterdir()} == FOLDERS


def test_the_package_of_a_checkout_has_no_copy_of_a_data_file():
    package = Path(jaxtwin.__file__).parent
    names = {path.name for path in data_folder().rglob("*.*")}
    assert not [path for path in package.rglob("*") if path.name in names]


def test_an_installed_package_has_them_inside(tmp_path):
    """As hatch lays them out in a wheel; `make wheel-check` compares the files of a real one."""
    package = tmp_path / "site-packages" / "jaxtwin"
    source = Path(jaxtwin.__file__).parent
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(data_folder(), package / "_data")
    code = "import jaxtwin.data as d, jaxtwin.rig as r; print(d.data_folder(), *r.bundled_rigs())"
    printed = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(package.parent)!r}); {code}"],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env={"PATH": ""},
    ).stdout.split()
    assert printed == [
        str(package / "_data"),
        *sorted(f.stem for f in CHECKOUT.glob("data/rigs/*")),
    ]
