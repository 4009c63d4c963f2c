"""Work in a process of its own ends with the server, whenever that is closed."""

import time

import pytest

from jaxtwin.serve._child_process import ChildProcess


@pytest.mark.parametrize("wait", [0.0, 0.05, 0.5])
def test_work_that_has_just_begun_is_ended_by_a_close(wait: float) -> None:
    child = ChildProcess()
    child.begin(time.sleep, 60.0)
    time.sleep(wait)
    begun = time.monotonic()
    child.close()
    assert time.monotonic() - begun < 30.0
