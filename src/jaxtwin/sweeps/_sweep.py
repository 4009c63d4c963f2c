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
from .._display import html_table, picture
from .._errors import SimulationError
from .._executor import Executor, check_executor, work_in_units
from .._waiting import silent
from ..io import Experiment
from ..matching import Fit
from ..physics import Twin
from ..simulation import Precision
from ._open import count_failed, open_sweep
from ._plan import Plan, plan_sweep
from ._progress_meter import ProgressMeter, SweepProgress
from ._store import Store

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

CHUNK = 65536
"""Draws in a chunk. A kill costs at most one chunk, some seconds of a CPU."""


@final
@dataclass(frozen=True)
class Sweep:
    """The state of a sweep.

    **Arguments:**

    - `folder`: of the results.
    - `rig`: name.
    - `draws`: number of draws asked for.
    - `done`: number of draws finished, by all processes and runs; `failed`: those that failed.
    - `new`: number of draws finished by this run, in `wall_time` seconds including compilation.
    - `busy`: number of chunks that another process was working on.
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
        """The results of the finished draws, as `open_sweep` reads them."""
        return open_sweep(self.folder)

    def to_dataframe(self) -> "pandas.DataFrame":
        """The results of the draws that are done as a table, all of them in memory: a row for each
        draw, recording, channel and parameter. Of a long sweep take a part of `to_xarray` first."""
        return self.to_xarray().to_dataframe()

    def plot(self) -> "Figure":
        """How what was kept is distributed over the draws that are done:
        `jaxtwin.plots.plot_distributions`."""
        return picture("plot_distributions", self.to_xarray())

    def _repr_html_(self) -> str:
        rows = [(name, str(value)) for name, value in self.to_dict().items()]
        return html_table(f"Sweep of {self.rig}", ("", ""), rows)

    def to_dict(self) -> dict[str, Any]:
        """The counts in plain types for JSON."""
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
    parameters: Iterable[str] | None = None,
    reductions: Iterable[str] | None = None,
    precision: Precision = "float64",
    chunk_size: int = CHUNK,
    executor: Executor | None = None,
    on_progress: Callable[[SweepProgress], None] | None = None,
) -> Sweep:
    """Simulates many random draws of a twin's parameters and writes reductions of them to a folder.

    The same call resumes where an earlier one stopped, however it was stopped. An executor spreads
    the work over processes and hosts; so do several calls at once whose processes see the same
    folder, as each takes the chunks that no other is at. Draws and results are the same for any
    number of stops, workers and processes.

    **Arguments:**

    - `twin`: the parameters are drawn around its values. One twin, one for each experiment, or a
      fit, of which each recording uses its own values (those of a recording that was not matched
      are estimated from its first minute, see `Fit.twin_for`).
    - `experiments`: one or several, each simulated for every draw; None for those of the fit.
    - `folder`: for the Zarr store. A missing or empty folder is filled; any other must hold this
      sweep.
    - `draws`, `spread`, `seed`: as in `sensitivity`.
    - `parameters`: which to draw; by default the free ones that all recordings share.
    - `reductions`: what to keep, see `simulate_batch`; by default "final", and "cost" where every
      experiment has recorded temperatures.
    - `precision`: of the computation and of what is kept.
    - `chunk_size`: draws that are computed and written at a time.
    - `executor`: who computes the chunks instead of this process, one thread each; see
      `simulate_batch`. This process alone writes to the folder.
    - `on_progress`: called with a `SweepProgress` whenever simulations have finished.

    **Returns:** a `Sweep`, once no chunk is left that another process is not at.

    **Raises:** `ParameterError` for unknown names or a value of zero; `SimulationError` for numbers
    out of range, experiments that do not belong to the rig, a folder of another sweep or of
    something else, a disk that does not take the results, or an executor that fails; `MatchError`
    where a recording that a fit has not seen is too short to take its own values from.
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
        parameters=parameters,
        reductions=reductions,
        precision=precision,
        chunk_size=chunk_size,
    )
    store = Store(place, plan)
    sizes = -np.subtract(*np.transpose([plan.span(chunk) for chunk in range(plan.chunks)]))
    before = store.done()
    left = np.flatnonzero(~before).tolist()
    meter = ProgressMeter(int(sizes[before].sum()), plan.draws, len(plan.experiments), on_progress)
    new: list[int] = []
    solved = _solve_here if executor is None else partial(_solve_by, executor)
    with closing(solved(store, left, meter)) as chunks:
        for chunk, results in chunks:
            store.write(chunk, results)
            new.append(chunk)
    done = store.done()
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


Solved: TypeAlias = Generator[tuple[int, dict[str, Shaped[np.ndarray, "draws *columns"]]]]
"""Numbers of chunks and their results, by the name of the array."""


def _solve_here(store: Store, chunks: list[int], meter: ProgressMeter) -> Solved:
    """One chunk after the other: other processes may be at the next ones meanwhile."""
    for chunk in chunks:
        with store.claim([chunk]) as mine:
            if mine and not store.is_done(chunk):
                yield chunk, store.plan.solve(chunk, meter)
            else:
                start, stop = store.plan.span(chunk)
                meter.add_elsewhere(stop - start)


def _solve_by(executor: Executor, store: Store, chunks: list[int], meter: ProgressMeter) -> Solved:
    """All chunks that are left, in the order in which workers finish them."""
    plan = store.plan
    with store.claim(chunks) as mine:
        mine = [chunk for chunk in mine if not store.is_done(chunk)]
        units = [(plan, chunk) for chunk in mine]
        where = "sweep: executor"
        for number, results in work_in_units(where, executor, _solve_chunk, units, SimulationError):
            yield mine[number], results
            start, stop = plan.span(mine[number])
            meter((stop - start) * len(plan.experiments))


def _solve_chunk(plan: Plan, chunk: int) -> dict[str, Shaped[np.ndarray, "draws *columns"]]:
    with silent():
        return plan.solve(chunk, None, workers=1)
