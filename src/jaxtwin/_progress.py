"""Work that takes long: how it reports its progress, and what the person who waits is told."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol, final, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Shows the progress of a piece of work that consists of steps."""

    def step(self, text: str) -> None:
        """Ends the step under way, if there is one, and begins the next."""
        ...

    def update(self, text: str) -> None:
        """Reports the progress of the step under way."""
        ...


@final
class NullProgress:
    """Shows nothing."""

    def step(self, text: str) -> None:
        """Does nothing."""

    def update(self, text: str) -> None:
        """Does nothing."""


# Messages about work that takes long, for the person who waits for it.
#
# On a terminal and in a notebook they are printed. Everywhere they go to the logger `jaxtwin`: a
# script sees them with `logging.basicConfig(level=logging.INFO)`.

# The time after which a message is printed, s.
PRINTED_AFTER = 2.0

# The shortest time between two messages on the progress of the same work, s.
PAUSE = 10.0

log = logging.getLogger("jaxtwin")


@final
class _Work:
    """Work that is announced.

    **Arguments:**

    - `name`: its name.
    - `show`: called with the text of each progress; None if nobody shows it.
    - `prints`: whether its progress is printed.
    """

    def __init__(self, name: str, show: Callable[[str], None] | None, prints: bool):
        self._name, self._show, self._prints = name, show, prints
        self._began = self._reported = time.perf_counter()

    def advance(self, done: int, total: int | None, detail: str) -> None:
        """Reports progress, from any thread."""
        now = time.perf_counter()
        text = f"{done}" if total is None else f"{done} of {total}"
        if total is not None and 0 < done < total:
            text += f", {_duration((now - self._began) * (total - done) / done)} left"
        text = ", ".join(part for part in (text, detail) if part)
        if self._show is not None:
            self._show(text)
        if now - self._reported < PAUSE:
            return
        self._reported = now
        log.info("%s: %s", self._name, text)
        if self._prints:
            _say(f"{self._name}: {text}")


_silent: ContextVar[bool] = ContextVar("_silent", default=False)
_work: ContextVar[_Work | None] = ContextVar("_work", default=None)
_show: ContextVar[Callable[[str], None] | None] = ContextVar("_show", default=None)


@contextmanager
def announced(work: str) -> Iterator[None]:
    """Prints a message on standard error if the work takes longer than two seconds, and at its end
    the time that it took and the part of compilation in it.

    Messages are printed only on a terminal or in a notebook. Work within announced work prints
    none.

    **Arguments:**

    - `work`: the name of the work, such as "match of dual-cell to 3 recordings".
    """
    if _work.get() is not None:
        yield
        return
    prints = not _silent.get() and _somebody_reads()
    token = _work.set(_Work(work, _show.get(), prints))
    try:
        with _printed(work, prints):
            yield
    finally:
        _work.reset(token)


def advanced(done: int, total: int | None = None, detail: str = "") -> None:
    """Reports how far the announced work is, with the time that remains, every ten seconds at most.

    **Arguments:**

    - `done`, `total`: the parts that are done, and all of them; without `total` the time that
      remains is not known.
    - `detail`: more in words, such as the cost of an iteration.
    """
    work = _work.get()
    if work is not None and done:
        work.advance(done, total, detail)


def counting(total: int, on_progress: Callable[[int], None] | None) -> Callable[[int], None]:
    """A callback for the number of parts that are done each time. It reports them as progress of
    the announced work, and calls a user's own callback."""
    work, done = _work.get(), 0  # here, because threads that report do not know the work

    def report(number: int) -> None:
        nonlocal done
        done += number
        if work is not None:
            work.advance(min(done, total), total, "")
        if on_progress is not None:
            on_progress(number)

    return report


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


@contextmanager
def _printed(work: str, prints: bool) -> Iterator[None]:
    """Prints the beginning of long work and its end, and logs the end."""
    start, compiled = time.perf_counter(), compiling_seconds()
    timer = threading.Timer(PRINTED_AFTER, _say, [f"{work} ..."])
    timer.daemon = True
    if prints:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        seconds = time.perf_counter() - start
        if seconds > PRINTED_AFTER:
            text = f"{work}: {seconds:.1f} s{_share(compiling_seconds() - compiled)}"
            log.info("%s", text)
            if prints:
                _say(text)


@contextmanager
def silent(show: Callable[[str], None] | None = None) -> Iterator[None]:
    """Suppresses the messages inside the block, for callers that report their progress themselves.

    **Arguments:**

    - `show`: called with the text of each progress; None if nobody shows it.
    """
    tokens = _silent.set(True), _show.set(show)
    try:
        yield
    finally:
        _silent.reset(tokens[0])
        _show.reset(tokens[1])


def compiling_seconds() -> float:
    # This imports JAX, which a command that only prints its help does not need.
    from ._compilation import compiling_seconds

    return compiling_seconds()


def _somebody_reads() -> bool:
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


def _share(compiling: float) -> str:
    if compiling < PRINTED_AFTER / 2:
        return ""
    return f", {compiling:.1f} s of it compilation, which is kept for the next time"


def _say(text: str) -> None:
    print(f"jaxtwin: {text}", file=sys.stderr, flush=True)
