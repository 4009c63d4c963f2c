"""What all tests share: shape checks, reproducible examples, float64 on request."""

import os
import shutil
from collections.abc import Iterator

import hypothesis
import jax
import pytest
from jaxtyping import install_import_hook

# Before the first import of jaxtwin: every annotated shape and type in the package is checked.
install_import_hook("jaxtwin", "beartype.beartype")

# Figures are drawn in memory, whatever the machine has for a screen.
os.environ["MPLBACKEND"] = "Agg"

hypothesis.settings.register_profile("jaxtwin", derandomize=True, deadline=None)
hypothesis.settings.load_profile("jaxtwin")


@pytest.fixture
def float64() -> Iterator[None]:
    """64-bit JAX for a test that computes with jax.numpy itself.

    jaxtwin's own solves switch to float64 by themselves; the setting is left alone everywhere else
    so that the tests see what a user sees.
    """
    with jax.enable_x64(True):
        yield


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves comparisons with ngspice out where it is not installed; they count as deselected."""
    if shutil.which("ngspice"):
        return
    needs_ngspice = [item for item in items if item.get_closest_marker("ngspice")]
    config.hook.pytest_deselected(items=needs_ngspice)
    items[:] = [item for item in items if item not in needs_ngspice]


def pytest_report_header() -> str:
    """Says at the top whether ngspice is there."""
    return f"ngspice: {shutil.which('ngspice') or 'not installed, its comparisons do not run'}"
