"""A rig, its twin, and a clock that stands still."""

import os
import shutil
from collections.abc import Iterator

import pytest
from hand_clock import HandClock

import jaxtwin as jt
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

os.environ["PATH"] += os.pathsep + "/usr/sbin"  # where Debian puts mosquitto


@pytest.fixture(scope="session")
def rig() -> Rig:
    return jt.load_rig("dual-cell")


@pytest.fixture(scope="session")
def twin(rig: Rig) -> Twin:
    return Twin(rig)


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what needs a program that is not installed; it counts as deselected."""
    for marker, program in (("mosquitto", "mosquitto"), ("compiler", "c++")):
        if shutil.which(program) is None:
            left_out = [item for item in items if item.get_closest_marker(marker)]
            config.hook.pytest_deselected(items=left_out)
            items[:] = [item for item in items if item not in left_out]


@pytest.fixture
def no_threads_left() -> Iterator[None]:
    """No thread of a link outlives its test."""
    import threading

    before = set(threading.enumerate())
    yield
    assert {t for t in set(threading.enumerate()) - before if t.name.startswith("link ")} == set()
