"""A virtual rig in a process of its own, as a device is: it goes on whatever this program does."""

import contextlib
import multiprocessing
from multiprocessing.connection import Connection
from types import TracebackType
from typing import final

from ..errors import JaxtwinError, LinkError
from ..live import WATCHDOG_SECONDS, SystemClock, TcpServer, VirtualRig
from ..live import serve as serve_device
from ..physics import Faults, Twin
from ._child_process import end_with_parent

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
