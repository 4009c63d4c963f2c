"""Progress of a command, on standard error.

On a terminal each step has a line that is updated while the step runs, and that shows its time at
the end. Elsewhere (a log, a pipe, a terminal that only prints lines) a step that takes a second or
more has a plain line, with an update every ten seconds at most.
"""

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from .._progress import Progress, silent

SHOWN_AFTER = 1.0  # s before a step is worth a plain line
PAUSE = 10.0  # s between two plain lines of progress


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Shows progress while the block runs. If it fails, the step under way is left unmarked."""
    # On a terminal that can only print lines, rich would show nothing at all.
    living = sys.stderr.isatty() and os.environ.get("TERM", "").lower() not in ("dumb", "unknown")
    shown = LiveProgress() if living else PlainProgress()
    try:
        with silent(shown.update):
            yield shown
        if isinstance(shown, LiveProgress):
            shown.finish()
    finally:
        shown.stop()


class PlainProgress:
    """Plain lines; a step that ends within a second has none."""

    def __init__(self) -> None:
        self.timer: threading.Timer | None = None
        self.last_line = 0.0

    def step(self, text: str) -> None:
        self.stop()
        self.last_line = time.monotonic()
        self.timer = threading.Timer(SHOWN_AFTER, self._print_line, [f"{text} ..."])
        self.timer.daemon = True
        self.timer.start()

    def update(self, text: str) -> None:
        if time.monotonic() - self.last_line >= PAUSE:
            self._print_line(f"  {text}")

    def stop(self) -> None:
        if self.timer is not None:
            self.timer.cancel()

    def _print_line(self, line: str) -> None:
        self.last_line = time.monotonic()
        print(line, file=sys.stderr, flush=True)


class LiveProgress:
    """A spinner with the step and its progress, by rich."""

    def __init__(self) -> None:
        from rich.console import Console

        self.console = Console(stderr=True, highlight=False)
        self.status = self.console.status("")
        self.text = ""
        self.began = 0.0

    def step(self, text: str) -> None:
        from rich.markup import escape

        self.finish()
        self.text, self.began = escape(text), time.monotonic()
        self.status.update(self.text)
        self.status.start()

    def update(self, text: str) -> None:
        from rich.markup import escape

        self.status.update(f"{self.text} [dim]{escape(text)}[/]")

    def finish(self) -> None:
        if self.text:
            self.status.stop()
            took = time.monotonic() - self.began
            self.console.print(f"[green]✓[/] {self.text} [dim]{took:.1f} s[/]")
            self.text = ""

    def stop(self) -> None:
        self.status.stop()
