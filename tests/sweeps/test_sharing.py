"""Workers of an executor, or several processes, share a sweep and give the numbers of one."""

import multiprocessing
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from jaxtwin import Experiment, reduce_batch
from jaxtwin.errors import SimulationError
from jaxtwin.sensitivity_analysis import normal_draws
from jaxtwin.sweeps import SweepProgress, _store, sweep

ASKED: dict[str, Any] = {"draws": 40, "chunk_size": 8, "reductions": ["final", "plate_std"]}


def test_workers_give_the_bytes_of_none(stored, tmp_path, twin, experiment, engine):
    """Chunks are written in the order in which they are done."""
    with ThreadPoolExecutor(3) as executor:
        shared = sweep(
            twin, experiment, tmp_path / "shared", draws=40, chunk_size=8, executor=executor
        )
    alone = sweep(twin, experiment, tmp_path / "alone", draws=40, chunk_size=8)
    assert (shared.new, shared.done, shared.busy) == (40, 40, 0)
    assert (alone.new, len(engine.given)) == (40, 10)
    assert stored(tmp_path / "shared") == stored(tmp_path / "alone")


@pytest.mark.slow
def test_real_processes_give_the_bytes_of_none(stored, tmp_path, twin, real_sweep):
    """By spawn, each with a JAX of its own."""
    context = multiprocessing.get_context("spawn")
    experiment = Experiment.schedule("0:0.5,10:0.8", duration=30.0, cells=2)
    with ProcessPoolExecutor(2, mp_context=context) as executor:
        sweep(twin, experiment, tmp_path / "two", draws=400, chunk_size=10, executor=executor)
    assert stored(tmp_path / "two") == stored(real_sweep.folder)


@pytest.mark.parametrize("with_executor", [False, True])
def test_chunks_that_another_process_is_at_are_left_to_it(
    tmp_path, twin, experiment, engine, monkeypatch, with_executor
):
    """Several processes may do the same sweep at once, without knowing of each other."""
    monkeypatch.setattr(_store, "lock", lambda file, chunk: chunk not in (0, 3))
    with ThreadPoolExecutor(1) as pool:
        result = sweep(
            twin,
            experiment,
            tmp_path,
            draws=40,
            chunk_size=8,
            executor=pool if with_executor else None,
        )
    assert (result.new, result.busy, result.complete) == (24, 2, False)


@pytest.mark.slow
def test_a_sweep_holds_what_a_batch_of_the_same_draws_gives(tmp_path, twin, experiment):
    """To rounding, though the batch is cut differently."""
    result = sweep(twin, experiment, tmp_path, **ASKED, names=["R_E", "R_pc"])
    table = result.to_xarray()
    draws = normal_draws({"R_E": 1.9674922600619191, "R_pc": 0.09}, 0.25, 0, 40)
    batch = reduce_batch(twin, experiment, draws, ["final", "plate_std"])
    assert batch.final is not None
    assert batch.plate_std is not None
    np.testing.assert_allclose(table.final, batch.final, rtol=0, atol=1e-9)
    np.testing.assert_allclose(table.plate_std[:, 0], batch.plate_std, rtol=0, atol=1e-9)


def test_twins_with_values_of_their_own_get_the_same_relative_draws(
    tmp_path, twin, experiment, engine
):
    """As in a sensitivity analysis of several recordings; one failure fails the draw."""
    other = twin.with_values({"R_E": 2 * float(twin.values["R_E"])})
    result = sweep([twin, other], [experiment] * 2, tmp_path, draws=10, chunk_size=10)
    first, second = engine.given
    np.testing.assert_allclose(second, 2 * first, rtol=1e-15)
    table = result.to_xarray()
    assert list(table.channel) == ["T11", "TAM", "T11 (2)", "TAM (2)"]
    assert table.failed.values.tolist() == (second > 2.8).tolist()


class Exhausted:
    """An executor that does so many units at once and takes no more."""

    def __init__(self, units: int):
        self.units = units

    def submit(self, fn: Any, /, *args: Any) -> Future[Any]:
        if not self.units:
            raise RuntimeError("shut down")
        self.units -= 1
        job: Future[Any] = Future()
        job.set_result(fn(*args))
        return job


def test_progress_counts_draws_from_where_it_goes_on(tmp_path, twin, experiment, engine):
    """Two simulations a draw here; rate and time left are known from the second report on."""
    both = [experiment, experiment]
    with pytest.raises(SimulationError, match="left; pass a new one"):
        sweep(twin, both, tmp_path, draws=30, chunk_size=10, executor=Exhausted(1))
    seen: list[SweepProgress] = []
    sweep(twin, both, tmp_path, draws=30, chunk_size=10, on_progress=seen.append)
    assert [(advance.done, advance.total) for advance in seen] == [
        (15, 30), (20, 30), (25, 30), (30, 30)
    ]  # fmt: skip
    assert seen[0].rate is None
    assert all(advance.rate and advance.remaining is not None for advance in seen[1:])
    assert seen[-1].remaining == 0
    assert (
        str(SweepProgress(20, 100, 12.3, 6600.0)) == "20 of 100 draws, 12 draws/s, 1 h 50 min left"
    )
