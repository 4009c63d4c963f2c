"""Several processes share a sweep and give the numbers of one."""

import json
import os
import socket
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from jaxtwin import SimulationError, simulate_batch
from jaxtwin.sensitivity_analysis import normal_draws
from jaxtwin.sweeps import SweepProgress, sweep
from jaxtwin.sweeps._parts import assigned_part

ASKED: dict[str, Any] = {"draws": 40, "chunk_size": 8, "reductions": ["final", "plate_std"]}


def test_parts_are_disjoint_and_make_the_whole(stored, tmp_path, twin, experiment, engine):
    """Chunk k belongs to process k modulo the number of processes."""
    drawn = []
    for number in range(3):
        engine.given.clear()
        sweep(twin, experiment, tmp_path / "shared", draws=40, chunk_size=8, process=(number, 3))
        drawn += engine.given
    assert len(drawn) == 5
    sweep(twin, experiment, tmp_path / "alone", draws=40, chunk_size=8)
    assert stored(tmp_path / "shared") == stored(tmp_path / "alone")


@pytest.mark.slow
def test_a_sweep_holds_what_a_batch_of_the_same_draws_gives(tmp_path, twin, experiment):
    """To rounding, though the batch is cut differently."""
    result = sweep(twin, experiment, tmp_path, **ASKED, parameters=["R_E", "R_pc"])
    table = result.to_xarray()
    draws = normal_draws({"R_E": 1.9674922600619191, "R_pc": 0.09}, 0.25, 0, 40)
    batch = simulate_batch(twin, experiment, draws, reductions=["final", "plate_std"])
    assert batch.final is not None
    assert batch.plate_std is not None
    np.testing.assert_allclose(table.final, batch.final, rtol=0, atol=1e-9)
    np.testing.assert_allclose(table.plate_std[:, 0], batch.plate_std, rtol=0, atol=1e-9)


def test_twins_with_values_of_their_own_get_the_same_relative_draws(
    tmp_path, twin, experiment, engine
):
    """As in a sensitivity analysis of several recordings; one failure fails the draw."""
    other = twin.with_parameters({"R_E": 2 * float(twin.parameters["R_E"])})
    result = sweep([twin, other], [experiment] * 2, tmp_path, draws=10, chunk_size=10)
    first, second = engine.given
    np.testing.assert_allclose(second, 2 * first, rtol=1e-15)
    table = result.to_xarray()
    assert list(table.channel) == ["T11", "TAM", "T11 (2)", "TAM (2)"]
    assert table.failed.values.tolist() == (second > 2.8).tolist()


@pytest.mark.slow
def test_two_processes_that_meet_by_jax_distributed_give_the_numbers_of_one(
    stored, tmp_path, real_sweep
):
    """On the loopback address, each its own `jaxtwin sweep`."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "jaxtwin.cli", *real_sweep.command, "--json", "-"]
    command += ["--out", str(tmp_path / "two")]
    command += ["--coordinator", f"127.0.0.1:{port}", "--processes", "2"]
    environment = os.environ | {"JAXTWIN_COMPILATION_CACHE": str(tmp_path / "compiled")}
    workers = [
        subprocess.Popen(
            [*command, "--process-id", str(number)], env=environment, stdout=subprocess.PIPE
        )
        for number in range(2)
    ]
    answers = [json.loads(worker.communicate()[0]) for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0]
    assert [answer["new"] for answer in answers] == [200, 200]
    assert stored(tmp_path / "two") == stored(real_sweep.folder)


def test_an_initialised_jax_says_which_part_is_whose(monkeypatch):
    """A user's own script may have called `jax.distributed.initialize`."""
    assert assigned_part() == (0, 1)
    monkeypatch.setattr("jax.distributed.is_initialized", lambda: True)
    monkeypatch.setattr("jax.process_index", lambda: 3)
    monkeypatch.setattr("jax.process_count", lambda: 4)
    assert assigned_part() == (3, 4)
    assert assigned_part((1, 2)) == (1, 2), "what is said comes first"


@pytest.mark.parametrize("part", [(-1, 2), (2, 2), (0, 0)])
def test_a_part_that_there_is_not_is_refused(part):
    with pytest.raises(SimulationError, match=f"process: .* got {part[0]} of {part[1]}"):
        assigned_part(part)


def test_progress_counts_draws_from_where_it_goes_on(tmp_path, twin, experiment, engine):
    """Two simulations a draw here; rate and time left are known from the second report on."""
    both = [experiment, experiment]
    sweep(twin, both, tmp_path, draws=30, chunk_size=10, process=(0, 3))
    seen: list[SweepProgress] = []
    sweep(twin, both, tmp_path, draws=30, chunk_size=10, on_progress=seen.append)
    assert [(advance.done, advance.total) for advance in seen] == [
        (15, 30), (20, 30), (25, 30), (30, 30)
    ]  # fmt: skip
    assert seen[0].rate is None
    assert all(advance.rate and advance.left is not None for advance in seen[1:])
    assert seen[-1].left == 0
    assert (
        str(SweepProgress(20, 100, 12.3, 6600.0)) == "20 of 100 draws, 12 draws/s, 1 h 50 min left"
    )
