"""Sweeps of millions of draws, written to disk chunk by chunk and resumed after a stop."""

import os
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, final

import numpy as np
from jaxtyping import Shaped

from .._arguments import check_callable, path_of
from .._display import picture
from .._executor import Executor, check_executor, work_in_units
from .._progress import silent
from .._result import AbstractResult, table
from ..errors import SimulationError
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..simulation import Precision, draws_table
from ._plan import Plan, plan_sweep
from ._store import Store, count_failed, open_sweep

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


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


# The number of draws in a chunk. A killed process loses at most one chunk, some seconds of CPU
# time.
CHUNK = 65536


@final
@dataclass(frozen=True)
class Sweep(AbstractResult):
    """The state of a sweep.

    **Arguments:**

    - `folder`: the folder of the results.
    - `rig`: the name of the rig.
    - `draws`: the number of draws of the sweep.
    - `done`: the number of draws that all processes and runs have finished; `failed`: the number of
      these that failed.
    - `new`: the number of draws that this run finished, in `wall_time` seconds including
      compilation.
    - `busy`: the number of chunks that another process was working on.
    """

    folder: Path
    rig: str
    draws: int
    done: int
    failed: int
    new: int
    wall_time: float
    busy: int

    @property
    def complete(self) -> bool:
        """Whether every draw is done."""
        return self.done == self.draws

    def to_xarray(self) -> "xarray.Dataset":
        """The results of the finished draws: see `open_sweep`."""
        return open_sweep(self.folder)

    def to_dataframe(self) -> "pandas.DataFrame":
        """The results of the finished draws as a table with a row for each draw, and a column for
        each of its numbers, such as `R_E`, `cost[day 1, T11]`. The table is in memory: for a long
        sweep, select a part of `to_xarray` first."""
        return draws_table(self.to_xarray())

    def plot(self) -> "Figure":
        """Plots the distribution of each reduction over the finished draws:
        `jaxtwin.plots.plot_distributions`."""
        return picture("plot_distributions", self.to_xarray())

    def _overview(self) -> "pandas.DataFrame":
        return table(self.to_dict().items(), columns=("", "value"))

    def _for_json(self) -> dict[str, Any]:
        return {
            "folder": str(self.folder),
            "rig": self.rig,
            "draws": self.draws,
            "done": self.done,
            "failed": self.failed,
            "complete": self.complete,
            "new": self.new,
            "wall_time_s": self.wall_time,
            "draws_per_s": self.new / self.wall_time,
        }


def sweep(
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
    folder: str | os.PathLike[str],
    *,
    draws: int,
    spread: float | int = 0.25,
    seed: int = 0,
    names: Iterable[str] | None = None,
    reductions: Iterable[str] | None = None,
    precision: Precision = "float64",
    chunk_size: int = CHUNK,
    executor: Executor | None = None,
    on_progress: Callable[[SweepProgress], None] | None = None,
) -> Sweep:
    """Simulates many random draws of a twin's parameters and writes reductions of them to a folder.

    The same call resumes a sweep that was stopped, in whatever way. An executor distributes the
    work over processes and hosts. Several processes that see the same folder can also make the same
    call: each works on chunks that no other process is working on. Draws and results do not depend
    on interruptions or on the number of workers and processes.

    **Arguments:**

    - `twin`: the twin around whose values the parameters are drawn; or a twin for each experiment;
      or a fit, of which each recording uses its own values (those of a recording that was not
      matched are estimated from its first minute, see `Fit.twin_for`).
    - `experiments`: one or several experiments, each simulated for every draw; None for those of
      the fit.
    - `folder`: the folder of the Zarr store. A missing or empty folder is filled; any other must
      hold the same sweep.
    - `draws`, `spread`, `seed`: as in `sensitivity`.
    - `names`: the parameters that are drawn; by default the free ones that all recordings
      share.
    - `reductions`: the reductions that are kept, see `reduce_batch`; by default "final", and
      "cost" if every experiment has recorded temperatures.
    - `precision`: the precision of the computation and of the stored results.
    - `chunk_size`: the number of draws that are computed and written at a time.
    - `executor`: an executor whose workers compute the chunks instead of this process, with one
      thread each; see `simulate_batch`. Only this process writes to the folder.
    - `on_progress`: called with a `SweepProgress` whenever simulations have finished.

    **Returns:** a `Sweep`, when every chunk is finished or in the hands of another process.

    **Raises:** `ParameterError` for unknown names or a value of zero; `SimulationError` for numbers
    out of range, experiments that do not belong to the rig, a folder that holds another sweep or
    something else, results that cannot be written, or an executor that fails; `MatchError` if a
    recording that was not matched is too short to estimate its own values.
    """
    began = time.perf_counter()
    place = path_of("sweep: folder", folder, SimulationError)
    check_callable("sweep: on_progress", on_progress, SimulationError)
    check_executor("sweep: executor", executor, SimulationError)
    plan = plan_sweep(
        twin,
        experiments,
        draws=draws,
        spread=spread,
        seed=seed,
        names=names,
        reductions=reductions,
        precision=precision,
        chunk_size=chunk_size,
    )
    store = Store(place, plan)
    sizes = -np.subtract(*np.transpose([plan.span(chunk) for chunk in range(plan.chunks)]))
    before = store.finished_chunks()
    left = np.flatnonzero(~before).tolist()
    meter = ProgressMeter(int(sizes[before].sum()), plan.draws, len(plan.experiments), on_progress)
    new: list[int] = []
    solved = _solve_here if executor is None else partial(_solve_by, executor)
    with closing(solved(store, left, meter)) as chunks:
        for chunk, results in chunks:
            store.write(chunk, results)
            new.append(chunk)
    done = store.finished_chunks()
    return Sweep(
        folder=store.folder,
        rig=plan.twins[0].rig.name,
        draws=plan.draws,
        done=int(sizes[done].sum()),
        failed=count_failed(store.folder, done, plan.chunk_size),
        new=int(sizes[new].sum()),
        wall_time=time.perf_counter() - began,
        busy=len(set(left) - set(new) - set(np.flatnonzero(done).tolist())),
    )


# Pairs of the number of a chunk and its results, name of the array -> values.
Solved: TypeAlias = Generator[tuple[int, dict[str, Shaped[np.ndarray, "draws *columns"]]]]


def _solve_here(store: Store, chunks: list[int], meter: ProgressMeter) -> Solved:
    """Solves one chunk after the other. Other processes may solve further chunks meanwhile."""
    for chunk in chunks:
        with store.claim([chunk]) as mine:
            if mine and not store.is_finished(chunk):
                yield chunk, store.plan.solve(chunk, meter)
            else:
                start, stop = store.plan.span(chunk)
                meter.add_elsewhere(stop - start)


def _solve_by(executor: Executor, store: Store, chunks: list[int], meter: ProgressMeter) -> Solved:
    """Solves the remaining chunks by an executor, and yields them in the order in which they
    finish."""
    plan = store.plan
    with store.claim(chunks) as mine:
        mine = [chunk for chunk in mine if not store.is_finished(chunk)]
        units = [(plan, chunk) for chunk in mine]
        where = "sweep: executor"
        for number, results in work_in_units(where, executor, _solve_chunk, units, SimulationError):
            yield mine[number], results
            start, stop = plan.span(mine[number])
            meter((stop - start) * len(plan.experiments))


def _solve_chunk(plan: Plan, chunk: int) -> dict[str, Shaped[np.ndarray, "draws *columns"]]:
    with silent():
        return plan.solve(chunk, None, workers=1)
