"""How far a sweep is, how fast it goes and how long it will take."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Advance:
    """A look at a sweep under way.

    **Arguments:**

    - `done`, `total`: draws of this process's part, those of earlier runs included.
    - `rate`: draws per second, without the first, which waits for the compiler.
    - `left`: s until the part is done; None as long as nobody can tell.
    """

    done: int
    total: int
    rate: float | None
    left: float | None

    def __str__(self) -> str:
        text = f"{self.done} of {self.total} draws"
        if self.rate is None or self.left is None:
            return text
        return f"{text}, {self.rate:.0f} draws/s, {_clock(self.left)} left"


@final
class Meter:
    """Turns finished simulations into `Advance`.

    **Arguments:**

    - `done`, `total`: draws.
    - `simulations`: of each draw, one an experiment.
    - `tell`: who wants to know.
    """

    def __init__(
        self, done: int, total: int, simulations: int, tell: Callable[[Advance], None] | None
    ):
        self.begun, self.total, self.simulations = done, total, simulations
        self.tell = tell
        self.finished = 0
        self.first: tuple[int, float] | None = None

    def __call__(self, simulations: int) -> None:
        """Some simulations are done; called by one thread at a time."""
        self.finished += simulations
        now = time.perf_counter()
        if self.first is None:
            self.first = self.finished, now
        if self.tell is None:
            return
        before, since = self.first
        draws = self.finished // self.simulations
        done = self.begun + draws
        rate = left = None
        if self.finished > before and now > since:
            rate = (self.finished - before) / self.simulations / (now - since)
            left = (self.total - done) / rate
        self.tell(Advance(done, self.total, rate, left))


def _clock(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{seconds // 60:.0f} min {seconds % 60:.0f} s"
    return f"{seconds // 3600:.0f} h {seconds % 3600 // 60:.0f} min"
