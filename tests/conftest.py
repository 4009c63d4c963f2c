"""What all tests share: shape checks, reproducible examples, float64 on request."""

import importlib.util
import os
import shutil
from collections.abc import Iterator

import hypothesis
import jax
import pytest
from jaxtyping import install_import_hook

# Before the first import of jaxtwin: every annotated shape and type in the package is checked.
install_import_hook("jaxtwin", "beartype.beartype")

os.environ["PATH"] += os.pathsep + "/usr/sbin"  # where Debian puts mosquitto

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


PROGRAMS = {"ngspice": "ngspice", "mosquitto": "mosquitto", "compiler": "c++"}
"""Marker -> the program that its tests need."""

MODULES = {"salib": "SALib"}
"""Marker -> the Python module that its tests need."""


def found() -> dict[str, str | None]:
    """Marker -> where its program or module is, None where it is not installed."""
    places = {marker: shutil.which(program) for marker, program in PROGRAMS.items()}
    for marker, module in MODULES.items():
        spec = importlib.util.find_spec(module)
        places[marker] = spec and spec.origin
    return places


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what needs a program or module that is not installed; it counts as deselected."""
    for marker, place in found().items():
        if place:
            continue
        left_out = [item for item in items if item.get_closest_marker(marker)]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


def pytest_report_header() -> list[str]:
    """Says at the top which programs and modules are there."""
    return [
        f"{(PROGRAMS | MODULES)[marker]}: {place or 'not installed, its tests do not run'}"
        for marker, place in found().items()
    ]
