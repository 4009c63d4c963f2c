"""Every Python snippet of the README and of docs/ runs, in the order in which a reader meets them,
in an empty folder and without a network.

What would take minutes is made smaller, and a loop that goes on for ever is stopped as its reader
would, by an interrupt.
"""

import ast
import contextlib
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.live import Reading, SystemClock, TcpServer, VirtualRig, connect, serve

CHECKOUT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
SMALLER = {
    "moment.time > 600": "moment.time > 3",
    '"0:30,300:35", duration=600)': '"0:30", duration=5)',
}

# Of the virtual rig in the pages.
ADDRESS = "127.0.0.1:7000"

# Where it listens in the test, because two pages may run at the same time, and which rig it is.
LISTENING = {
    "docs/live-python.md": ("127.0.0.1:7000", "dual-cell"),
    "docs/control.md": ("127.0.0.1:7002", "tclab"),
}

# Of docs/firmware/lepton.md.
CAMERA = "127.0.0.1:7001"

pytestmark = pytest.mark.slow


def snippets(page: str) -> list[str]:
    return BLOCK.findall((CHECKOUT / page).read_text())


PAGES = [
    str(page.relative_to(CHECKOUT))
    for page in (CHECKOUT / "README.md", *sorted((CHECKOUT / "docs").rglob("*.md")))
    if "```python" in page.read_text()
]


@pytest.fixture
def prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """An empty folder, and the names that every program has."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", lambda: None)
    return {"print": print}


@pytest.mark.parametrize("page", PAGES)
def test_every_snippet_runs(page: str, prepared: dict[str, Any]) -> None:
    code = "\n".join(snippets(page))
    for long, short in SMALLER.items():
        code = code.replace(long, short)
    if page in LISTENING:
        code = code.replace(ADDRESS, LISTENING[page][0])
    if "if __name__ ==" in code:  # a program of several processes, which import it
        Path("program.py").write_text(code)
        subprocess.run([sys.executable, "program.py"], check=True)
        return
    with surroundings_of(page, prepared):
        for statement in ast.parse(code).body:
            with contextlib.suppress(KeyboardInterrupt):
                exec(compile(ast.Module([statement], []), page, "exec"), prepared)
    plt.close("all")


@contextlib.contextmanager
def surroundings_of(page: str, names: dict[str, Any]) -> Iterator[None]:
    """What a page's reader has already."""
    if page in LISTENING:
        if page == "docs/live-python.md":
            names["print"] = printing_for(5.0)
        with rig_that_listens(*LISTENING[page]):
            yield
    elif page == "docs/firmware/lepton.md":
        with host_of_the_camera(names):
            yield
    else:
        yield


def printing_for(seconds: float) -> Callable[..., None]:
    """A `print` that ends with Ctrl-C so many seconds after it was first called."""
    calls: list[float] = []

    def shown(*_: object) -> None:
        calls.append(time.monotonic())
        if calls[-1] > calls[0] + seconds:
            raise KeyboardInterrupt

    return shown


@contextlib.contextmanager
def host_of_the_camera(names: dict[str, Any]) -> Iterator[None]:
    """A driver that yields pictures of 30 degC for a second, and the host that reads them."""
    twin = jt.Twin("dual-cell")

    def frames() -> Iterator[tuple[int, np.ndarray, bool]]:
        for number in range(20):
            yield number, np.full((60, 80), 30315, np.uint16), number == 10
            time.sleep(0.05)
        raise KeyboardInterrupt

    names["frames"] = frames
    with connect(twin.rig, f"socket://{CAMERA}") as connection:
        yield
        names["connection"].close()
        names["server"].close()
        readings = [record for record in connection.poll() if isinstance(record, Reading)]
    assert [reading.recalibrating for reading in readings].count(True) == 1
    for reading in readings:
        np.testing.assert_allclose(reading.temperatures, 30.0, atol=1e-6)


@contextlib.contextmanager
def rig_that_listens(address: str, name: str) -> Iterator[None]:
    server, stop = TcpServer(address), threading.Event()
    rig = VirtualRig(jt.Twin(name), speed=5.0)
    thread = threading.Thread(target=serve, args=(rig, server, SystemClock(), stop))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        server.close()
