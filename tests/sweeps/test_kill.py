"""A sweep that is killed again and again ends with the bytes of one that never was.

SIGKILL, as `kill -9` sends it, cannot be caught: nothing can be tidied up.
"""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxtwin.sweeps import sweep

CHUNKS = 60
# The store is what is killed here, so the engine is one that needs no compiler, and the processes
# are forked from one that has imported everything: it answers each line with the child's number.
NURSERY = """
import os, sys, numpy, jaxtwin, xarray, zarr
from jaxtwin.simulation import Reductions
from jaxtwin.sweeps import _plan

def quick(twin, experiment, draws, reductions, **options):
    R_E = draws["R_E"]
    return Reductions(("T11", "TAM"), R_E > 2.8, final=numpy.stack([R_E, 2 * R_E], axis=1))

_plan.reduce_batch = quick
twin = jaxtwin.Twin("paper-2024")
experiment = jaxtwin.Experiment.schedule(
    "0:0.5,10:0.8", duration=30.0, cells=2, channels=("T11", "TAM"), name="half a minute"
)
for line in sys.stdin:
    child = os.fork()
    if not child:
        jaxtwin.sweep(twin, experiment, sys.argv[1], draws=180, chunk_size=3)
        os._exit(0)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "stops",
    [(0, 14, 32), pytest.param((0, 3, 8, 14, 20, 26, 32, 38, 44), marks=pytest.mark.long)],
    ids=["few", "many"],
)
def test_killed_at_random_moments_no_draw_is_lost_or_done_twice(
    stored, tmp_path, twin, experiment, engine, stops
):
    """A process is killed some milliseconds after it has done some more chunks, so that the kill
    falls into any part of a chunk's work; a mark that is there is never written again."""
    sweep(twin, experiment, tmp_path / "whole", draws=180, chunk_size=3)
    folder = tmp_path / "killed"
    dice = random.Random(0)
    written: dict[Path, int] = {}
    with subprocess.Popen(
        [sys.executable, "-c", NURSERY, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as nursery:
        assert nursery.stdin is not None
        assert nursery.stdout is not None
        for stop in (*stops, None):
            print("next", file=nursery.stdin, flush=True)
            child = int(nursery.stdout.readline())
            if stop is not None:
                wait(folder, stop + dice.randrange(6))
                time.sleep(dice.uniform(0, 0.01))
                os.kill(child, signal.SIGKILL)
            assert int(nursery.stdout.readline()) == (0 if stop is None else -signal.SIGKILL)
            times = {mark: mark.stat().st_mtime_ns for mark in marks(folder)}
            assert {mark: times[mark] for mark in written} == written
            assert stop is None or len(times) < CHUNKS
            written = times
        nursery.stdin.close()
    assert stored(folder) == stored(tmp_path / "whole")


@pytest.mark.long
def test_a_killed_command_goes_on(stored, tmp_path, real_sweep):
    """The command line with the true engine, killed after its first chunk."""
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "jaxtwin.cli", *real_sweep.command, "--out", str(folder)]
    environment = os.environ | {"JAXTWIN_COMPILATION_CACHE": str(tmp_path / "compiled")}
    with subprocess.Popen(command, env=environment) as process:
        wait(folder, 1)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    assert 1 <= len(marks(folder)) < real_sweep.chunks
    subprocess.run(command, env=environment, check=True, capture_output=True)
    assert stored(folder) == stored(real_sweep.folder)


def wait(folder: Path, chunks: int) -> None:
    """Until that many chunks are done."""
    deadline = time.monotonic() + 300
    while len(marks(folder)) < chunks:
        assert time.monotonic() < deadline
        time.sleep(0.001)


def marks(folder: Path) -> list[Path]:
    return list((folder / "done").glob("[0-9]*"))
