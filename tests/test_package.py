"""The package's face: what `import jaxtwin` offers and what it leaves alone."""

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest

import jaxtwin
from jaxtwin import errors

MOVED: dict[str, str] = vars(jaxtwin)["_MOVED"]


def run_fresh(code: str) -> str:
    """Runs code in a Python that has imported nothing yet and returns what it prints."""
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_every_public_name_resolves_to_something_of_its_own():
    names = sorted(jaxtwin.__all__)
    assert "JaxtwinError" in names
    assert set(names) <= set(dir(jaxtwin))
    assert not [name for name in names if isinstance(getattr(jaxtwin, name), ModuleType)]


def test_every_module_can_be_imported():
    """Types of arguments too are made from what the libraries of the day offer."""
    for module in pkgutil.walk_packages(jaxtwin.__path__, "jaxtwin."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        getattr(jaxtwin, "no_such_name")  # noqa: B009
    with pytest.raises(AttributeError, match=r"no attribute 'simualte'; did you mean 'simulate'\?"):
        getattr(jaxtwin, "simualte")  # noqa: B009


def test_import_loads_no_heavy_library():
    """Fast start: everything that costs time is imported when it is first needed."""
    heavy = "{'jax', 'matplotlib', 'numpy', 'pint', 'pydantic', 'scipy', 'xarray'}"
    assert run_fresh(f"import sys, jaxtwin; print({heavy} & set(sys.modules))") == "set()\n"


def test_a_rig_is_read_without_jax():
    """`jaxtwin check` and `jaxtwin rigs` pay for no library that computes."""
    code = (
        "import sys\nfrom jaxtwin.rig import bundled_rigs, load_rig\n"
        "for name in bundled_rigs(): load_rig(name)\n"
        "print({'jax', 'scipy', 'xarray'} & set(sys.modules))"
    )
    assert run_fresh(code) == "set()\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("used", "left_out"),
    [
        (
            "jt.Twin('paper-2024').simulate('0:0.5', duration=10)",
            "diffrax lineax matplotlib optimistix pandas pooch scipy.optimize scipy.stats typer",
        ),
        ("jt.match", "diffrax matplotlib pandas scipy.optimize scipy.signal scipy.stats xarray"),
        ("jt.sensitivity", "diffrax matplotlib pandas scipy.signal scipy.stats xarray"),
    ],
)
def test_what_is_used_imports_no_library_of_other_things(used, left_out):
    """The first result comes sooner: diffrax alone is a fifth of what a simulation imports."""
    code = f"import sys, jaxtwin as jt; {used}; print(set({left_out.split()}) & set(sys.modules))"
    assert run_fresh(code) == "set()\n"


@pytest.mark.slow
def test_import_leaves_the_settings_of_jax_alone():
    """docs/performance.md promises it: no setting changes, whatever public names are used."""
    code = (
        "import jax; before = dict(jax.config.values)\n"
        "from jaxtwin import *\n"
        "print({k for k, v in jax.config.values.items() if before.get(k) != v})"
    )
    assert run_fresh(code) == "set()\n"


def test_no_public_name_is_that_of_a_submodule():
    """Importing a submodule sets it as an attribute of the package: it would hide the name."""
    submodules = {module.name for module in pkgutil.iter_modules(jaxtwin.__path__)}
    assert {"matching", "sensitivity_analysis", "sweeps"} <= submodules
    assert not submodules & set(jaxtwin.__all__)


def test_every_error_is_caught_as_a_jaxtwin_error():
    raised = [value for value in vars(errors).values() if isinstance(value, type)]
    assert len(raised) > 10
    assert all(issubclass(error, jaxtwin.JaxtwinError) for error in raised)


def test_the_public_names_fit_on_a_page():
    assert len(jaxtwin.__all__) <= 50


@pytest.mark.parametrize("name", sorted(MOVED))
def test_a_name_that_has_moved_works_with_a_warning_that_says_where(name: str):
    package, _, renamed = MOVED[name].partition(".")
    place = f"{package}.{renamed or name}"
    with pytest.warns(DeprecationWarning, match=rf"jaxtwin\.{name} is now jaxtwin\.{place}$"):
        moved = getattr(jaxtwin, name)
    assert moved is getattr(importlib.import_module(f"jaxtwin.{package}"), renamed or name)
    assert name not in jaxtwin.__all__


def test_a_package_is_imported_when_it_is_first_used():
    assert run_fresh("import jaxtwin as jt; print(jt.control.PID.__name__)") == "PID\n"


@pytest.mark.parametrize(
    ("package", "old", "new"),
    [
        ("control", "DiscreteModel", "StateSpace"),
        ("control", "LinearModel", "StateSpace"),
        ("control", "UniformityMPC", "design_uniformity_mpc"),
        ("monitoring", "Seen", "ObservedSample"),
        ("physics", "CALM", "MIN_FILM_RISE"),
    ],
)
def test_a_renamed_name_of_a_package_warns_and_is_the_new_one(package: str, old: str, new: str):
    module = importlib.import_module(f"jaxtwin.{package}")
    assert old not in module.__all__
    with pytest.warns(DeprecationWarning, match=rf"jaxtwin\.{package}\.{old} is now .*{new}$"):
        assert getattr(module, old) is getattr(module, new)


def test_names_for_other_packages_are_found_and_not_public():
    module = importlib.import_module("jaxtwin.rig")
    assert callable(module.parse_toml)
    assert "parse_toml" not in dir(module)
