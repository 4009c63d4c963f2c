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
from types import TracebackType
from typing import Any, NamedTuple, final

from ..errors import JaxtwinError, LinkError
from ..live import WATCHDOG_SECONDS, SystemClock, TcpServer, VirtualRig
from ..live import serve as serve_device
from ..physics import Faults, Twin

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


# A virtual rig in a process of its own, as a device is: it goes on whatever this program does.

# The longest time until it is ready, s: it compiles its twin.
START_SECONDS = 120.0


# The frames of its camera in a second of the host: a page shows no more pictures.
FRAMES_PER_SECOND = 10.0

# The smallest number of them in a second of the rig: a controller samples once in it.
MIN_FRAMES_PER_SECOND = 2.0


@final
class VirtualLink:
    """Runs a virtual rig while the block runs.

    **Arguments:**

    - `twin`: the twin that it simulates.
    - `speed`: the seconds of the rig in a second.
    - `faults`: the faults that it simulates.
    - `seed`: the seed of noise and faults.
    """

    def __init__(self, twin: Twin, *, speed: float | int = 1.0, faults: Faults, seed: int = 0):
        context = multiprocessing.get_context("spawn")
        self._answer, theirs = context.Pipe()
        self._process = context.Process(
            target=_run, args=(theirs, twin, speed, faults, seed), name="virtual rig", daemon=True
        )
        # It compiles while this process does other things.
        self._process.start()
        theirs.close()

    def __enter__(self) -> "VirtualLink":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.join()
        self._answer.close()

    def url(self) -> str:
        """Waits until it is ready, and returns the address of its link. Its time begins now.

        **Raises:** `LinkError` if it cannot be started, such as for a fault of a part that the rig
        does not have.
        """
        with contextlib.suppress(EOFError, BrokenPipeError):
            if self._answer.poll(START_SECONDS):
                url, problem = self._answer.recv()
                if problem:
                    raise LinkError(f"virtual rig: {problem}")
                self._answer.send("begin")
                return url
        raise LinkError("virtual rig: expected a process that starts, got one that has ended")


def _run(answer: Connection, twin: Twin, speed: float, faults: Faults, seed: int) -> None:
    end_with_parent()
    try:
        frames = min(max(FRAMES_PER_SECOND / speed, MIN_FRAMES_PER_SECOND), FRAMES_PER_SECOND)
        # A host that is busy with other things commands late; a rig of a story need not trip.
        longest = WATCHDOG_SECONDS[1]
        device = VirtualRig(
            twin, speed=speed, seed=seed, camera_rate=frames, faults=faults, watchdog=longest
        )
        server = TcpServer("127.0.0.1:0")
    except JaxtwinError as error:
        answer.send(("", str(error)))
        return
    answer.send((server.url, ""))
    answer.recv()
    serve_device(device, server, SystemClock())
