"""Diagnoses and refits: work that takes seconds, on an executor."""

import contextlib
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple, final

from .._executor import Executor, work_in_units
from ..errors import JaxtwinError
from ..serve._child_process import NICE, end_with_parent

# The number of units that a cluster has at a time.
UNITS_OF_CLUSTER = 32


class Done(NamedTuple):
    """A job that has ended: `problem` says why there is no result; `""` if there is one."""

    rig: str
    kind: str
    value: Any
    problem: str


@final
class Jobs:
    """Has work done for rigs, one job of a kind for each at a time.

    **Arguments:**

    - `executor`: does it, such as that of Dask; None: a process of this machine, one job after the
      other.
    """

    def __init__(self, executor: Executor | None = None):
        self._executor, self._is_local = executor, executor is None
        self._waiters = ThreadPoolExecutor(1 if executor is None else UNITS_OF_CLUSTER)
        self._running: dict[tuple[str, str], Future[Any]] = {}

    def begin(
        self,
        rig: str,
        kind: str,
        work: Callable[..., Any],
        arguments: Callable[[], tuple[Any, ...]],
    ) -> bool:
        """Begins work for a rig, whose arguments are made when its turn has come; false if the same
        goes on already."""
        if (rig, kind) in self._running:
            return False
        self._running[rig, kind] = self._waiters.submit(self._wait, kind, work, arguments)
        return True

    def take(self) -> list[Done]:
        """The jobs that have ended since the last call."""
        ended = [key for key, future in self._running.items() if future.done()]
        return [self._done(*key, self._running.pop(key)) for key in ended]

    def close(self) -> None:
        """Ends work that goes on."""
        self._waiters.shutdown(wait=False, cancel_futures=True)
        if self._is_local and isinstance(self._executor, ProcessPoolExecutor):
            for process in list((self._executor._processes or {}).values()):
                process.terminate()
            self._executor.shutdown(wait=True, cancel_futures=True)

    @staticmethod
    def _done(rig: str, kind: str, future: Future[Any]) -> Done:
        try:
            return Done(rig, kind, future.result(), "")
        except JaxtwinError as problem:
            return Done(rig, kind, None, str(problem))

    def _wait(
        self, kind: str, work: Callable[..., Any], arguments: Callable[[], tuple[Any, ...]]
    ) -> Any:
        if self._executor is None:
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(1, mp_context=context, initializer=_begin_worker)
        try:
            ((_, result),) = work_in_units(kind, self._executor, work, [arguments()], JaxtwinError)
        except JaxtwinError as problem:
            if self._is_local and isinstance(problem.__cause__, BrokenProcessPool):
                self._executor = None  # the next job gets a process of its own again
            raise
        return result


def _begin_worker() -> None:
    """A worker ends with the fleet, and lets it go first."""
    end_with_parent()
    with contextlib.suppress(AttributeError, OSError):  # Windows has no niceness
        os.nice(NICE)
