"""Work in units that an executor hands to its workers: processes of this machine, or of a cluster.

A unit is a function of this package and its arguments. It contains everything on which its result
depends, so that any worker can compute it, and compute it again if another worker was lost.
"""

import multiprocessing
import pickle
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import Any, Protocol, TypeVar, runtime_checkable

from .errors import JaxtwinError

Result = TypeVar("Result")

# The number of times that a unit is submitted before its failure is raised.
ATTEMPTS = 3

# The interval at which jobs that are not futures are polled, s.
POLL = 0.2


@runtime_checkable
class Job(Protocol):
    """The job of a unit on an executor: a `concurrent.futures.Future`, or an object like it."""

    def result(self) -> Any: ...

    def done(self) -> bool: ...

    def cancel(self) -> Any: ...


@runtime_checkable
class Executor(Protocol):
    """A `concurrent.futures.Executor`, or anything else with its `submit`."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any: ...


def check_executor(where: str, executor: object, error: type[JaxtwinError]) -> None:
    """Refuses an executor without `submit`, and one that forks processes: a forked process lacks
    JAX's threads, and would wait for them forever. None is accepted.

    **Raises:** `error`.
    """
    if executor is None:
        return
    if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
        raise error(
            f"{where}: expected a concurrent.futures.Executor or None, got {executor!r}; pass "
            "Client(...).get_executor() of Dask, for example"
        )
    if isinstance(executor, ProcessPoolExecutor):
        context = getattr(executor, "_mp_context", None) or multiprocessing.get_context()
        if context.get_start_method() == "fork":
            raise error(
                f"{where}: expected processes that start afresh, got a ProcessPoolExecutor that "
                'forks this one; pass mp_context=multiprocessing.get_context("spawn") to it'
            )


def work_in_units(
    where: str,
    executor: Executor,
    work: Callable[..., Result],
    units: Iterable[tuple[Any, ...]],
    error: type[JaxtwinError],
) -> Generator[tuple[int, Result]]:
    """Computes all units on an executor.

    A unit that fails is submitted again, because its worker may have been lost; the third failure
    is raised. If the executor refuses further units, those that it has are finished first. If the
    generator is closed, units that have not begun are cancelled.

    **Arguments:**

    - `where`: the function and the argument, for messages.
    - `work`: a function of a module, which pickle can name.
    - `units`: the arguments of each unit.
    - `error`: the exception for failures that are not errors of this package.

    **Returns:** the number of each unit and its result, in the order in which they finish.
    """
    arguments = list(units)
    attempts = [0] * len(arguments)
    unfinished = len(arguments)
    waiting: dict[Job, int] = {}
    refusal: Exception | None = None
    to_submit = list(range(len(arguments)))
    try:
        while to_submit or waiting:
            for number in to_submit:
                try:
                    waiting[executor.submit(work, *arguments[number])] = number
                except RuntimeError as problem:  # shut down, or broken by the death of a worker
                    refusal = problem
                    break
                attempts[number] += 1
            to_submit = []
            if not waiting:
                break
            for job in _finished(waiting):
                number = waiting.pop(job)
                try:
                    result = job.result()
                except JaxtwinError:
                    raise
                except Exception as problem:
                    _check_sendable(where, problem, error)
                    if attempts[number] == ATTEMPTS:
                        raise error(
                            f"{where}: unit {number} of {len(arguments)} failed {ATTEMPTS} times, "
                            f"the last time with {type(problem).__name__}: {problem}"
                        ) from problem
                    if refusal is None:
                        to_submit.append(number)
                else:
                    unfinished -= 1
                    arguments[number] = ()  # frees their memory
                    yield number, result
    finally:
        for job in waiting:
            job.cancel()
    if unfinished:
        raise error(
            f"{where}: the executor takes no more work ({refusal}) with {unfinished} of "
            f"{len(arguments)} units left; pass a new one"
        ) from refusal


def _finished(waiting: Iterable[Job]) -> list[Job]:
    """Waits until at least one job is done, and returns all that are."""
    jobs = list(waiting)
    futures = [job for job in jobs if isinstance(job, Future)]
    if len(futures) == len(jobs):
        return list(wait(futures, return_when=FIRST_COMPLETED).done)
    while True:
        if done := [job for job in jobs if job.done()]:
            return done
        time.sleep(POLL)


def _check_sendable(where: str, problem: Exception, error: type[JaxtwinError]) -> None:
    is_about_pickling = isinstance(problem, AttributeError | TypeError) and "pickle" in str(problem)
    if isinstance(problem, pickle.PicklingError) or is_about_pickling:
        raise error(
            f"{where}: the work cannot be sent to another process: {problem}; define functions in "
            "a module, or use an executor that sends any function, such as Dask's"
        ) from problem
