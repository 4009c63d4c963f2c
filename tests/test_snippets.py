"""Every Python snippet of the README and of docs/ runs, in the order in which a reader meets them.

Rigs, recordings and a camera that a snippet takes for granted are made beforehand. What would take
minutes is made smaller, and a loop that goes on for ever is stopped as its reader would, by an
interrupt.
"""

import ast
import contextlib
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from placed_rig import GRID, placed_text

import jaxtwin as jt
import jaxtwin.io
from jaxtwin.data import data_folder, synthetic_recordings
from jaxtwin.live import Reading, SystemClock, TcpServer, VirtualRig, connect, serve

CHECKOUT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
SMALLER = {
    "1_000_000": "300",
    "10_000": "300",
    "draws=1000": "draws=300",
    "draws=4096": "draws=16",
    "moment.time > 600": "moment.time > 3",
    '"0:30,300:35", duration=600)': '"0:30", duration=5)',
    "LiveLoop(twin, relay, 40, duration=900)": "LiveLoop(twin, relay, 40, duration=5)",
    # Matches, of which each option is compiled anew, get two parameters; the notebooks match all.
    "fit = jt.match(twin, recordings)\nprint": (
        'fit = jt.match(twin, recordings, free=["R_E", "h_A"])\nprint'
    ),
    "match(twin, recordings, solver=": (
        'match(jt.Twin("single-cell"), "session-0.csv", free=["R_E", "R_Th"], solver='
    ),
    "match(twin, recordings, on_progress=": (
        'match(twin, recordings, free=["R_E", "h_A"], on_progress='
    ),
    "duration=1200, names=": "duration=600, names=",
    "match(twin, experiments)": 'match(twin, experiments, free=["R_E", "R_pc"])',
    'leave_one_out(jt.Twin("single-cell"), sessions)': (
        'leave_one_out(jt.Twin("single-cell"), sessions, free=["R_E", "R_Th"])'
    ),
    "match(twin, recordings, loss=": 'match(twin, recordings, free=["R_E", "h_A"], loss=',
    "loss=Huber(3.0),": 'loss=Huber(3.0), free=["R_E", "h_A"],',
    'free=[*names, "T_amb_drift"]': 'free=["R_E", "T_amb_drift"]',
    "[*recordings, full], groups=": '[*recordings, full], free=["R_E", "d_x"], groups=',
    'validate_split(jt.Twin("dual-cell"), experiments, 500.0)': (
        'validate_split(jt.Twin("dual-cell"), experiments, 500.0, free=["R_E", "h_A"])'
    ),
    "    rounds=10,": "    rounds=2,",
    "    rounds=6,": "    rounds=2,",
}
ADDRESS = "127.0.0.1:7000"
"""Of the virtual rig in the pages."""

LISTENING = {
    "docs/live-python.md": ("127.0.0.1:7000", "dual-cell"),
    "docs/control.md": ("127.0.0.1:7002", "tclab"),
}
"""Where it listens in the test, because two pages may run at the same time, and which rig it is."""

CAMERA = "127.0.0.1:7001"
"""Of docs/firmware/lepton.md."""

pytestmark = pytest.mark.slow


def snippets(page: str) -> list[str]:
    return BLOCK.findall((CHECKOUT / page).read_text())


PAGES = [
    str(page.relative_to(CHECKOUT))
    for page in (CHECKOUT / "README.md", *sorted((CHECKOUT / "docs").rglob("*.md")))
    if "```python" in page.read_text()
]


def record(rig: str, file: Path, seed: int) -> Path:
    """A short recording of a rig, with noise."""
    twin = jt.Twin(rig)
    cells = len(twin.rig.cells)
    drive = jt.Experiment.schedule("0:0,30:0.6,200:0.2", duration=400.0, cells=cells)
    run = jt.simulate(twin, drive)
    noise = np.random.default_rng(seed).normal(scale=0.1, size=run.temperatures.shape)
    recording = jt.Experiment(
        time=run.time,
        duty=drive.duty,
        temperatures=run.temperatures + noise,
        channels=run.channels,
        name=file.stem,
    )
    jt.write_recording(recording, file)
    return file


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What the pages name, and the sessions of the single cell."""
    folder = tmp_path_factory.mktemp("recordings")
    days = ("monday", "tuesday", "wednesday")
    made = {day: record("dual-cell", folder / f"{day}.csv", n) for n, day in enumerate(days)}
    for number in range(4):
        name = f"session-{number}"
        made[name] = record("single-cell", folder / f"{name}.csv", number)
    return made


@pytest.fixture
def prepared(
    recordings: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> dict[str, Any]:
    """The folder in which a page is read, and the names that it takes for granted."""
    monkeypatch.chdir(tmp_path)
    for name, file in recordings.items():
        (tmp_path / f"{name}.csv").write_bytes(file.read_bytes())
    # A rig whose cell has a place, on a coarse grid.
    (tmp_path / "plate.toml").write_text(placed_text(grid=GRID.replace('"1 cm"', '"2 cm"')))
    monkeypatch.setattr(plt, "show", lambda: None)

    def find_recordings(names: Any = None) -> tuple[Path, ...]:
        if names is None:
            return synthetic_recordings()
        assert set(names) <= {known.name for known in jaxtwin.io.SINGLE_CELL}
        return tuple(recordings[f"session-{number}"] for number in range(len(names)))

    monkeypatch.setattr(jt, "find_recordings", find_recordings, raising=False)
    return {"print": print}


@pytest.mark.parametrize("page", PAGES)
def test_every_snippet_runs(page: str, prepared: dict[str, Any]) -> None:
    code = "\n".join(snippets(page))
    for long, short in SMALLER.items():
        code = code.replace(long, short)
    if page in LISTENING:
        code = code.replace(ADDRESS, LISTENING[page][0])
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
    elif page == "docs/experiment-design.md":
        shutil.copy(data_folder() / "rigs/single-cell.toml", "my-rig.toml")
        names["recordings"] = [jt.read_recording("session-0.csv")]
        yield
    elif page == "docs/firmware/lepton.md":
        with host_of_the_camera(names):
            yield
    elif page == "docs/sweep.md":
        experiments = [jt.read_recording(path) for path in synthetic_recordings()]
        names["experiments"] = experiments
        jt.match(jt.Twin("paper-2024"), experiments[:1], free=["R_E"]).save("fit.toml")
        jt.sweep(jt.Twin("paper-2024", "fit.toml"), experiments, "sweep", draws=300, seed=0)
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
    rig = VirtualRig(jt.Twin(name))
    thread = threading.Thread(target=serve, args=(rig, server, SystemClock(), stop))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        server.close()
