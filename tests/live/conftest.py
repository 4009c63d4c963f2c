"""A rig, its twin, a clock that stands still, and an end to every wait."""

import signal
from collections.abc import Iterator
from types import FrameType

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


# Seconds that a test may wait for another process, on a machine that is busy.
LONGEST = 300


@pytest.fixture(autouse=True)
def _deadline() -> Iterator[None]:
    """Tests wait for what must happen, not for a time; what never happens fails in the end."""

    def over(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"waited for {LONGEST} s")

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(LONGEST)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def no_threads_left() -> Iterator[None]:
    """No thread of a link outlives its test."""
    import threading

    before = set(threading.enumerate())
    yield
    assert {t for t in set(threading.enumerate()) - before if t.name.startswith("link ")} == set()
