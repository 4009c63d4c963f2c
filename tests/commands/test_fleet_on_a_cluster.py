"""The heavy work of a fleet on a Dask cluster, by the address of its scheduler."""

import contextlib
import gc
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from small_fleet import Kind, encoded, fleet_file, messages, run, twin

from jaxtwin import match
from jaxtwin.commands._dask import dask_executor
from jaxtwin.fleet import Fleet
from jaxtwin.twin_store import TwinStore

pytestmark = pytest.mark.slow


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with a worker, each a process as on a host of a cluster."""
    file = tmp_path / "scheduler.json"
    common = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    with contextlib.ExitStack() as stack:
        for words in (["scheduler", "--port", "0"], ["worker", "--nthreads", "1"]):
            command = [sys.executable, "-m", "dask", *words, *common]
            quiet = subprocess.DEVNULL
            process = stack.enter_context(subprocess.Popen(command, stdout=quiet, stderr=quiet))
            stack.callback(process.terminate)
        end = time.monotonic() + 60
        while not file.exists():
            assert time.monotonic() < end
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"]
    # A client of Dask that was closed leaves its socket to the garbage collector.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def champion(folder: Path) -> Path:
    """A store whose champion is the twin of the fleet."""
    recording = twin().simulate("0:0.4/0.1,90:0.6/0.3", duration=200.0).to_recording(seed=5)
    store = TwinStore(folder / "store.db")
    store.add(match(twin(), recording), reason="the first", aliases=["champion"])
    return store.path


def until(fleet: Fleet, is_done: Callable[[], object]) -> None:
    end = time.monotonic() + 120
    while not is_done():
        assert time.monotonic() < end
        fleet._look()
        time.sleep(0.1)


def test_a_diagnosis_and_a_refit_are_done_by_a_worker(tmp_path, scheduler):
    store = champion(tmp_path)
    path = fleet_file(tmp_path, '["a"]', dask=scheduler)
    path.write_text(f'{path.read_text()}store = "{store.name}"\n')
    readings, counts = run(1)
    readings = readings + np.where(np.arange(len(readings)) < 250, 0.0, 3.0)[:, None] * [1, 0]
    several: list[tuple[str, Kind, bytes]] = [
        ("a", kind, encoded(content)) for kind, content in messages(readings, counts)
    ]
    with dask_executor(scheduler) as executor:
        fleet = Fleet(path, executor=executor)
        try:
            fleet.hear(fleet._journal.add(time.time_ns(), several))
            fleet.step(is_all=True)
            rig = fleet.rigs["a"]
            until(fleet, lambda: rig.diagnosis["state"] == "done")
            assert rig.fault.endswith(" T1")  # its gain or its offset
            assert not fleet.ask_for_refit("a")
            until(fleet, lambda: any(line["text"].startswith("refit: ") for line in rig.lines))
            assert rig.lines[-1]["text"].startswith("refit: rejected")
            (version,) = TwinStore(store).versions  # in which the worker has written it down
            assert any(text.startswith("rejected") for text in version.tags.values())
        finally:
            fleet.close()
