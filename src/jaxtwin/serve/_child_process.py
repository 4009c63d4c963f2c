"""Work in a process of its own, which ends with the server, however that ends.

In a thread of this process the tracing of a diagnosis or of a refit would keep the loop around the
rig waiting for many seconds: longer than the watchdog of a device waits.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple, final

from ..errors import JaxtwinError

# The niceness of such a process: the loop around the rig goes first.
NICE = 10


class Outcome(NamedTuple):
    """What a process has found, and why it has found nothing; `""` if it has."""

    value: Any
    problem: str


@final
class ChildProcess:
    """Does one thing at a time in a process of its own."""

    def __init__(self) -> None:
        # Starting a process waits for it, which the loop must not.
        self._waiter = ThreadPoolExecutor(1, thread_name_prefix="child process")
        self._running: Future[Outcome] | None = None
        self._process: SpawnProcess | None = None
        self._is_closed = False

    @property
    def is_running(self) -> bool:
        """Whether there is work that has not been taken."""
        return self._running is not None

    def begin(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Begins some work: a function of a module, and arguments that pickle can hold."""
        self._running = self._waiter.submit(self._wait, work, arguments)

    def take(self) -> Outcome | None:
        """Returns the outcome, once; None while there is none."""
        if self._running is None or not self._running.done():
            return None
        ready, self._running = self._running, None
        return ready.result()

    def close(self) -> None:
        """Ends work that goes on."""
        self._is_closed = True
        if self._process is not None:
            self._process.terminate()
        self._waiter.shutdown(wait=True, cancel_futures=True)

    def _wait(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
        context = multiprocessing.get_context("spawn")
        answer, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_do, args=(theirs, work, arguments), daemon=True)
        process.start()
        self._process = process  # only now can it be ended
        if self._is_closed:
            process.terminate()
        theirs.close()
        try:
            return answer.recv()
        except EOFError:
            return Outcome(None, "its process has ended")
        finally:
            process.join()
            answer.close()
            self._process = None


def end_with_parent() -> None:
    """Makes this process end when its parent has ended, also by a kill, and not by Ctrl-C, which
    reaches all processes of a terminal: the server first switches its cells off."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_wait_for_end, name="parent", daemon=True).start()


def _wait_for_end() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)


def _do(answer: Connection, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    end_with_parent()
    with contextlib.suppress(AttributeError, OSError):  # Windows has no niceness
        os.nice(NICE)
    try:
        value = work(*arguments)
    except JaxtwinError as error:
        answer.send(Outcome(None, str(error)))
    else:
        answer.send(Outcome(value, ""))
