"""Messages about work that takes long, for the person who waits for it."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

PATIENCE = 2.0
"""The time after which a message is printed, s."""

_silent: ContextVar[bool] = ContextVar("_silent", default=False)


@contextmanager
def announced(work: str) -> Iterator[None]:
    """Prints a message on standard error if the work takes longer than two seconds, and at its end
    the time that it took and the part of compilation in it.

    Messages are printed only on a terminal or in a notebook. Work within announced work prints
    none.

    **Arguments:**

    - `work`: the name of the work, such as "match of dual-cell to 3 recordings".
    """
    if _silent.get() or not _somebody_reads():
        yield
        return
    start, compiled = time.perf_counter(), compiling_seconds()
    timer = threading.Timer(PATIENCE, _say, [f"{work} ..."])
    timer.daemon = True
    timer.start()
    try:
        with silent():
            yield
    finally:
        timer.cancel()
        seconds = time.perf_counter() - start
        if seconds > PATIENCE:
            _say(f"{work}: {seconds:.1f} s{_share(compiling_seconds() - compiled)}")


@contextmanager
def silent() -> Iterator[None]:
    """Suppresses the messages inside the block, for callers that report their progress
    themselves."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


def compiling_seconds() -> float:
    # This imports JAX, which a command that only prints its help does not need.
    from ._compilation import compiling_seconds

    return compiling_seconds()


def _somebody_reads() -> bool:
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


def _share(compiling: float) -> str:
    if compiling < PATIENCE / 2:
        return ""
    return f", {compiling:.1f} s of it compilation, which is kept for the next time"


def _say(text: str) -> None:
    print(f"jaxtwin: {text}", file=sys.stderr, flush=True)
