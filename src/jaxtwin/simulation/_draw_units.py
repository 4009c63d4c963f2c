"""Divides draws into units of some thousands for the workers of an executor.

A unit consists of whole chunks, of the same size as without an executor. Each draw is therefore
computed together with the same other draws on any worker, and its result is the same to the last
bit.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from jaxtyping import Float

from .._executor import Executor, work_in_units
from ..errors import SimulationError
from ._draw_solver import Draws, DrawSolver
from ._refinement import Results
from ._workers import CHUNK_CPU

if TYPE_CHECKING:
    from ._diffeqsolve import DiffraxMethod

# The number of draws in a unit: about a second of CPU time, for some hundred kilobytes of data.
UNIT = 4096

# The largest size of the result of a unit with trajectories, bytes.
MAX_RESULT = 64 << 20

# The number of halvings of the steps for the default solver, or a method of diffrax.
SolverChoice: TypeAlias = "int | DiffraxMethod"


def solve_draws(
    solver: DrawSolver,
    draws: Draws,
    choice: SolverChoice,
    executor: Executor | None,
    on_progress: Callable[[int], None] | None = None,
    least: int = 0,
    out: Float[np.ndarray, "draws times channels"] | None = None,
) -> Results:
    """Solves draws in this process, or by the workers of an executor, each with one thread unless
    the solver has a number of threads. Chunks are at least as large as those of `least` draws, and
    temperatures may be written into `out`.

    **Raises:** `SimulationError` if the executor fails.
    """
    total = len(next(iter(draws.values())))
    chunked_as = max(total, least)
    if executor is None:
        return _solve(solver, draws, choice, on_progress, chunked_as, out)
    size = _unit_size(solver)
    alone = replace(solver, workers=solver.workers or 1)
    parts = [slice(first, min(first + size, total)) for first in range(0, total, size)]
    units = [
        (
            alone,
            {name: values[part] for name, values in draws.items()},
            choice,
            min(size, chunked_as),
        )
        for part in parts
    ]
    results: Results = {}
    with closing(work_in_units("executor", executor, _solve_unit, units, SimulationError)) as done:
        for number, result in done:
            part = parts[number]
            for name, values in result.items():
                if name not in results:
                    results[name] = np.empty((total, *values.shape[1:]), values.dtype)
                results[name][part] = values
            if on_progress is not None:
                on_progress(part.stop - part.start)
    return results


def _solve_unit(solver: DrawSolver, draws: Draws, choice: SolverChoice, total: int) -> Results:
    return _solve(solver, draws, choice, None, total)


def _solve(
    solver: DrawSolver,
    draws: Draws,
    choice: SolverChoice,
    on_progress: Callable[[int], None] | None,
    total: int,
    out: Float[np.ndarray, "draws times channels"] | None = None,
) -> Results:
    if isinstance(choice, int):
        return solver.solve(draws, choice, on_progress, total, out)
    return solver.solve_with_diffrax(draws, choice, on_progress, total)


def _unit_size(solver: DrawSolver) -> int:
    """The number of draws in a unit, a multiple of the chunk size."""
    reductions = solver.reductions
    trajectory = solver.experiment.time.size * max(1, solver.columns.size) * 8
    is_short = reductions and all(r.dimension != "unknown" for r in reductions.values())
    most = UNIT if is_short else min(UNIT, MAX_RESULT // trajectory)
    chunk = solver.chunk_size or CHUNK_CPU
    return max(1, most // chunk) * chunk
