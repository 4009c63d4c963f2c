"""Standard output and error that never block: a reader that has stopped reading must not keep a
heater on."""

import contextlib
import io
import os
import queue
import sys
import threading
from collections.abc import Iterator
from typing import Any, final

# The number of texts that wait for a reader; further ones are dropped.
MAX_WAITING = 1000

# The time that a reader has at the end, s.
FLUSH_SECONDS = 1.0


@contextlib.contextmanager
def unblocked_output() -> Iterator[None]:
    """While the block runs, what is printed, logged or shown as progress goes through a queue to a
    thread that writes it. A pipe that nobody empties blocks that thread alone.

    Streams without a file, as in tests, remain as they are.
    """
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = queued = [_queued(stream) for stream in streams]
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams
        for stream in queued:
            if stream not in streams:
                stream.close()


def _queued(stream: Any) -> Any:
    """A stream in place of another; the same if that has no file."""
    try:
        stream.flush()
        raw = _QueuedOutput(stream.fileno())
    except (OSError, ValueError):
        return stream
    # A name of a file may hold bytes that are no text.
    return io.TextIOWrapper(
        raw,  # pyright: ignore[reportArgumentType]
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=True,
    )


@final
class _QueuedOutput(io.RawIOBase):
    """A file whose writes return at once. Closing it waits for `FLUSH_SECONDS` at most."""

    def __init__(self, descriptor: int):
        self._descriptor = descriptor
        self._waiting: queue.Queue[bytes | None] = queue.Queue(MAX_WAITING)
        # A daemon: one that is blocked does not keep the program from ending.
        self._writer = threading.Thread(target=self._write_all, daemon=True, name="output")
        self._writer.start()

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def fileno(self) -> int:
        return self._descriptor

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        content = bytes(data)
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(content)
        return len(content)

    def close(self) -> None:
        if not self.closed:
            with contextlib.suppress(queue.Full):
                self._waiting.put_nowait(None)
            self._writer.join(FLUSH_SECONDS)
        super().close()

    def _write_all(self) -> None:
        while (data := self._waiting.get()) is not None:
            # A reader that is gone is not an error of the run.
            with contextlib.suppress(OSError):
                while data:
                    data = data[os.write(self._descriptor, data) :]
