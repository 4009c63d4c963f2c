"""A Dask cluster of processes on loopback, one of which is killed, gives the numbers of none."""

import os
import signal
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from distributed import Client, LocalCluster

from jaxtwin import Experiment, reduce_batch
from jaxtwin.cli import run
from jaxtwin.sensitivity_analysis import normal_draws
from jaxtwin.sweeps import SweepProgress, sweep

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """Four processes with a thread each."""
    options: dict[str, Any] = {"n_workers": 4, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        yield client


def test_a_worker_is_killed_and_its_chunks_go_to_another(
    stored, tmp_path, twin, real_sweep, client
):
    """By SIGKILL, when the first chunk is done; the store has the bytes of a sweep without."""
    killed: list[int] = []

    def kill_one(_: SweepProgress) -> None:
        if not killed:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    experiment = Experiment.schedule("0:0.5,10:0.8", duration=30.0, cells=2)
    result = sweep(
        twin,
        experiment,
        tmp_path / "cluster",
        draws=400,
        chunk_size=10,
        executor=client.get_executor(),
        on_progress=kill_one,
    )
    assert killed
    assert result.complete
    assert stored(tmp_path / "cluster") == stored(real_sweep.folder)


def test_draws_are_the_same_to_the_last_bit_and_functions_of_a_script_travel(
    twin, experiment, client
):
    """Dask sends any function; the draws with too little resistance are solved again, on finer
    steps or by a stiff solver."""
    draws = normal_draws({"R_E": 1.9674922600619191, "R_pc": 0.09}, 0.25, 0, 300)
    draws["R_pc"][::50] = 1e-4
    asked = {"final": "final", "hottest": lambda trajectory: trajectory.max()}
    alone = reduce_batch(twin, experiment, draws, asked, chunk_size=32)
    done: list[int] = []
    distributed = reduce_batch(
        twin,
        experiment,
        draws,
        asked,
        chunk_size=32,
        executor=client.get_executor(),
        on_progress=done.append,
    )
    assert sum(done) == 300
    np.testing.assert_array_equal(distributed["final"], alone["final"])
    np.testing.assert_array_equal(distributed["hottest"], alone["hottest"])


@pytest.mark.long
def test_the_command_finds_the_scheduler(stored, tmp_path, real_sweep, client, monkeypatch):
    monkeypatch.chdir(tmp_path)
    address = client.scheduler_info()["address"]
    assert run([*real_sweep.command, "--out", "out", "--dask", address]) == 0
    assert stored(tmp_path / "out") == stored(real_sweep.folder)
