"""A rig, its twin, and a clock that stands still."""

import shutil
from collections.abc import Iterator

import pytest
from hand_clock import HandClock

import jaxtwin as jt
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


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
    """Leaves tests with a broker out where mosquitto is not installed; they count as deselected."""
    if shutil.which("mosquitto"):
        return
    needs_broker = [item for item in items if item.get_closest_marker("mosquitto")]
    config.hook.pytest_deselected(items=needs_broker)
    items[:] = [item for item in items if item not in needs_broker]


@pytest.fixture
def no_threads_left() -> Iterator[None]:
    """No thread of a link outlives its test."""
    import threading

    before = set(threading.enumerate())
    yield
    assert {t for t in set(threading.enumerate()) - before if t.name.startswith("link ")} == set()
