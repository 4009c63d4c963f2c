"""The rig of the paper, and a small closed loop."""

import pytest

from jaxtwin import Twin
from jaxtwin.control import PID


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="session")
def pid() -> PID:
    return PID(Kp=0.1, Ki=0.001)
