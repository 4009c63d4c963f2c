"""The progress of a sweep: finished draws, speed and remaining time."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class SweepProgress:
    """The progress of a sweep.

    **Arguments:**

    - `done`, `total`: the numbers of finished draws and of all draws, including those of earlier
      runs and of other processes.
    - `rate`: draws per second, without the first chunk, which waits for the compiler; None until
      it is known.
    - `remaining`: the time until the sweep is complete, s; None until it is known.
    """

    done: int
    total: int
    rate: float | None
    remaining: float | None

    def __str__(self) -> str:
        text = f"{self.done} of {self.total} draws"
        if self.rate is None or self.remaining is None:
            return text
        return f"{text}, {self.rate:.0f} draws/s, {_clock(self.remaining)} left"


@final
class ProgressMeter:
    """Counts finished simulations and reports them as `SweepProgress`.

    **Arguments:**

    - `done`, `total`: the number of draws that were finished before, and of all draws.
    - `simulations`: the number of simulations of each draw, which is the number of experiments.
    - `on_progress`: a function that is called with a `SweepProgress` after each update, or None.
    """

    def __init__(
        self,
        done: int,
        total: int,
        simulations: int,
        on_progress: Callable[[SweepProgress], None] | None,
    ):
        self.done_before, self.total, self.simulations = done, total, simulations
        self.on_progress = on_progress
        self.finished = 0
        self.first: tuple[int, float] | None = None

    def __call__(self, simulations: int) -> None:
        """Adds finished simulations. Only one thread may call this at a time."""
        self.finished += simulations
        now = time.perf_counter()
        if self.first is None:
            self.first = self.finished, now
        if self.on_progress is None:
            return
        before, since = self.first
        draws = self.finished // self.simulations
        done = self.done_before + draws
        rate = remaining = None
        if self.finished > before and now > since:
            rate = (self.finished - before) / self.simulations / (now - since)
            remaining = (self.total - done) / rate
        self.on_progress(SweepProgress(done, self.total, rate, remaining))

    def add_elsewhere(self, draws: int) -> None:
        """Adds draws that another process is working on or has finished."""
        self.done_before += draws


def _clock(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{seconds // 60:.0f} min {seconds % 60:.0f} s"
    return f"{seconds // 3600:.0f} h {seconds % 3600 // 60:.0f} min"
