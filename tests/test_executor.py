"""Work handed to an executor: what is lost is done again, and what cannot be done is said."""

import multiprocessing
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import pytest

from jaxtwin._executor import check_executor, work_in_units
from jaxtwin.errors import SimulationError

SPAWN = multiprocessing.get_context("spawn")


def doubled(number: int) -> int:
    return 2 * number


def die(_: int) -> None:
    os._exit(1)


def done(executor: Any, work: Callable[..., Any] = doubled, count: int = 20) -> dict[int, Any]:
    units = ((number,) for number in range(count))
    return dict(work_in_units("here", executor, work, units, SimulationError))


class Forgetful:
    """Loses each unit so often before it does it."""

    def __init__(self, losses: int):
        self.losses, self.asked = losses, Counter[int]()

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Future[Any]:
        job: Future[Any] = Future()
        self.asked[args[0]] += 1
        if self.asked[args[0]] <= self.losses:
            job.set_exception(ConnectionError("the worker is gone"))
        else:
            job.set_result(fn(*args))
        return job


class SlowJob:
    """No future, and done at the second look, as jobs of submitit may be."""

    def __init__(self, fn: Callable[..., Any], args: tuple[Any, ...]):
        self.fn, self.args, self.looks = fn, args, 0

    def done(self) -> bool:
        self.looks += 1
        return self.looks > 1

    def result(self) -> Any:
        return self.fn(*self.args)

    def cancel(self) -> None: ...


class Slow:
    def submit(self, fn: Callable[..., Any], /, *args: Any) -> SlowJob:
        return SlowJob(fn, args)


def test_each_unit_is_done_once_by_threads_and_by_jobs_that_are_no_futures():
    expected = {number: 2 * number for number in range(20)}
    with ThreadPoolExecutor(3) as threads:
        assert done(threads) == expected
    assert done(Slow(), count=3) == {number: 2 * number for number in range(3)}


def test_a_lost_unit_is_handed_out_again():
    forgetful = Forgetful(2)
    assert done(forgetful) == {number: 2 * number for number in range(20)}
    assert set(forgetful.asked.values()) == {3}


def test_a_unit_that_is_lost_three_times_is_an_error():
    with pytest.raises(SimulationError, match=r"here: unit 0 of 1 failed 3 times.*worker is gone"):
        done(Forgetful(3), count=1)


def test_an_error_of_ours_is_not_tried_again():
    seen: list[int] = []

    def refuse(number: int) -> None:
        seen.append(number)
        raise SimulationError("R_E: expected a number above 0")

    with ThreadPoolExecutor(1) as threads, pytest.raises(SimulationError, match=r"^R_E: expected"):
        done(threads, refuse, count=1)
    assert seen == [0]


def test_what_is_left_when_iteration_ends_is_called_off():
    with ThreadPoolExecutor(1) as threads:
        units = work_in_units("here", threads, doubled, ((n,) for n in range(5)), SimulationError)
        assert next(units)[0] == 0
        units.close()


@pytest.mark.slow
def test_a_broken_pool_says_so():
    """`ProcessPoolExecutor` takes no more work once one of its processes has died."""
    with (
        ProcessPoolExecutor(1, mp_context=SPAWN) as pool,
        pytest.raises(SimulationError, match=r"takes no more work .* with 2 of 2 units left"),
    ):
        done(pool, die, count=2)


@pytest.mark.slow
def test_a_function_that_cannot_be_sent_is_told():
    with (
        ProcessPoolExecutor(1, mp_context=SPAWN) as pool,
        pytest.raises(SimulationError, match=r"here: the work cannot be sent .* define functions"),
    ):
        done(pool, lambda number: number)


@pytest.mark.parametrize("executor", [3, "dask", ThreadPoolExecutor])
def test_what_is_no_executor_is_refused(executor):
    with pytest.raises(SimulationError, match=r"here: expected a concurrent.futures.Executor"):
        check_executor("here", executor, SimulationError)


def test_forked_processes_are_refused():
    """JAX's threads would not be in them."""
    with (
        ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as pool,
        pytest.raises(SimulationError, match=r'mp_context=multiprocessing.get_context."spawn"'),
    ):
        check_executor("here", pool, SimulationError)
    with ProcessPoolExecutor(1, mp_context=SPAWN) as pool:
        check_executor("here", pool, SimulationError)
    check_executor("here", None, SimulationError)


FORKED = """
import multiprocessing, warnings
import jaxtwin as jt

warnings.simplefilter("ignore")
plan = jt.Experiment.schedule("0:0.5", duration=5, cells=2)


def job(name):
    return float(jt.simulate(jt.Twin(name), plan).temperatures[-1, 0])


job("tclab")
with multiprocessing.get_context("fork").Pool(1) as pool:
    try:
        pool.map_async(job, ["tclab"]).get(timeout=60)
    except jt.JaxtwinError as error:
        print(error)
"""


def test_a_fork_of_a_process_that_has_used_jax_is_refused_and_does_not_hang():
    done = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, check=False, timeout=120
    )
    assert "expected a process of its own, got a fork of process" in done.stdout, done.stderr
    assert 'get_context("spawn")' in done.stdout


def test_a_process_that_forks_before_it_uses_jax_does_its_work():
    text = (
        FORKED.replace('job("tclab")\n', "", 1)
        .replace("pool.map", "print(pool.map")
        .replace("timeout=60)", "timeout=60))")
    )
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False, timeout=120
    )
    assert "[2" in done.stdout, done.stderr
