"""How long does a draw take, and how exact is it, with each way of solving the same equations?

Every other tool is timed at its best: its settings (solver, linear solver, compiled or not,
tolerances) are searched first, and the fastest whose error is at most `LARGEST_ERROR` is taken.

python -m benchmarks.ways --quick
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import diffrax
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.simulation._native_library import VARIABLE

from ._casadi import HAS_COMPILER, CvodesSetting, cvodes, cvodes_cost
from ._measure import median_ratio, on_all_cores, rounds, run_alone
from ._one_lane import one_lane_compiler
from ._pydiffsol import DiffsolSetting, diffsol
from ._reference import reference_readings
from ._scipy import lsoda
from ._stock_diffrax import stock_diffrax
from ._sundae import cvode
from ._task import DUAL_CELL, PUBLISHED, STARTUP, Task

Run = Callable[[], Float[np.ndarray, "d t c"]]
Candidates = dict[str, Callable[[Task, int], Run]]
"""Setting -> what makes a way with that setting for some draws."""

LARGEST_ERROR = 1e-3
"""Of a way that is timed, against Radau at 1e-10, K."""

OURS = "jaxtwin, float64"

INPUTS = ("two levels", "closed loop", "noisy room")
"""Those of `drives` besides the steps with which each way is tried."""

CORES = os.cpu_count() or 1

CVODES = {
    str(setting): setting
    for tolerances, linear, compiled in product(
        [(1e-5, 1e-4), (5e-6, 1e-4), (5e-6, 5e-6), (2e-6, 1e-4), (1e-6, 1e-5), (1e-6, 1e-6)],
        ["ldl", "qr", "csparse"],
        [False, True] if HAS_COMPILER else [False],
    )
    for setting in [CvodesSetting(*tolerances, linear, compiled)]
}

DIFFSOL = {
    str(setting): setting
    for solver, matrix, tolerances in product(
        ["esdirk34", "bdf"],
        ["faer_sparse", "nalgebra_dense"],
        [(1e-5, 1e-4), (5e-6, 5e-5), (1e-6, 1e-5)],
    )
    for setting in [DiffsolSetting(solver, matrix, *tolerances)]
}

SOLVERS: tuple[diffrax.AbstractSolver, ...] = (
    diffrax.Kvaerno3(),
    diffrax.Kvaerno4(),
    diffrax.Kvaerno5(),
)
"""Of eight draws at 1e-5 KenCarp4, with an explicit part of nothing, takes 15 times as long as
Kvaerno3, and Tsit5 70 times."""


def _candidates(task: Task, quick: bool) -> dict[str, tuple[Candidates, int, int]]:
    """Tool -> its settings, how many draws the search takes, and how many are timed."""
    rust: Candidates = {name: partial(diffsol, setting=one) for name, one in DIFFSOL.items()}
    casadi: Candidates = {
        name: partial(cvodes, setting=setting) for name, setting in CVODES.items()
    }
    stock: Candidates = {
        f"{type(solver).__name__}, {tolerance:.0e}".replace("e-0", "e-"): partial(
            stock_diffrax, solver, tolerance=tolerance
        )
        for solver, tolerance in product(SOLVERS, (1e-5, 1e-6))
    }
    odeint: Candidates = {
        f"{tolerance:.0e}".replace("e-0", "e-"): partial(lsoda, tolerance=tolerance)
        for tolerance in (1e-5, 3e-6, 1e-6)
    }
    sundials: Candidates = {
        f"{tolerance:.0e}".replace("e-0", "e-"): partial(cvode, tolerance=tolerance)
        for tolerance in (1e-5, 3e-6, 1e-6)
    }
    if quick:
        casadi, stock, odeint, sundials, rust = (
            dict(list(c.items())[-1:]) for c in (casadi, stock, odeint, sundials, rust)
        )
    # pydiffsol's model has no lag, no on/off drive and no losses that are not linear.
    one_thread = {"pydiffsol": (rust, 16, 128)} if task.rig == "paper-2024" else {}
    tools = {
        "CasADi CVODES": (casadi, 32, 512),
        **one_thread,
        "diffrax, vmapped": (stock, 16, 64),
        "scipy LSODA": (odeint, 8, 8),
        "scikit-sundae CVODE": (sundials, 8, 8),
    }
    # Where the input changes more often, a draw takes other tools 20 to 100 times as long.
    part = 1 if task.inputs == "steps" else 8
    return {
        tool: (settings, max(few // part, 2), max(many // part, 2))
        for tool, (settings, few, many) in tools.items()
    }


def search(
    task: Task, candidates: Candidates, count: int, truth: Float[np.ndarray, "d t c"]
) -> tuple[str, dict[str, dict[str, float]]]:
    """The fastest setting whose error is small enough, and what each of them gave.

    Times are CPU times, over the number of cores, the better of two calls after one that does not
    count: what else the machine does would choose otherwise. Where no setting is exact enough, the
    most exact one is taken.
    """
    found = {}
    for name, make in candidates.items():
        run = make(task, count)
        error = float(np.abs(run()[: len(truth)] - truth).max())
        seconds = min(_cpu_seconds(run), _cpu_seconds(run))
        found[name] = {"ms_per_draw": 1e3 * seconds / CORES / count, "error_K": error}
    exact = {name: row for name, row in found.items() if row["error_K"] <= LARGEST_ERROR}
    if exact:
        return min(exact, key=lambda name: exact[name]["ms_per_draw"]), found
    return min(found, key=lambda name: found[name]["error_K"]), found


def _cpu_seconds(run: Run) -> float:
    began = time.process_time()
    run()
    return time.process_time() - began


def fastest(task: Task, tool: str, quick: bool) -> tuple[str, Callable[[Task, int], Run]]:
    """A tool's best setting for a task, and what makes it."""
    candidates, few, _ = _candidates(task, quick)[tool]
    truth = np.stack(on_all_cores(_truth, [(task, number) for number in range(2)]))
    best, _ = search(task, candidates, few, truth)
    return best, candidates[best]


def ours(
    task: Task,
    count: int,
    reductions: Any = None,
    native: bool = True,
    into: bool = False,
    one_lane: bool = False,
    **options: Any,
) -> Callable[[], Any]:
    """The batch engine: in C, of many draws in the lanes of a vector or of one at a time, or by the
    programs of JAX; into a new array or into the same."""
    experiment, draws = task.experiment, task.draws(count)

    shape = (count, len(experiment.time), len(task.twin.channels))
    out = np.empty(shape) if into else None

    def run() -> Any:
        os.environ[VARIABLE] = "on" if native else "off"
        os.environ["CC"] = one_lane_compiler() if one_lane else "cc"
        if reductions is None:
            return jt.simulate_batch(task.twin, experiment, draws, out=out, **options)
        return jt.reduce_batch(task.twin, experiment, draws, reductions, **options)

    run()
    return run


OWN: dict[str, dict[str, Any]] = {
    OURS: {},
    "jaxtwin, float64, into an array of the caller": {"into": True},
    "jaxtwin, float64, one thread": {"workers": 1},
    "jaxtwin, float64, cost and final": {"reductions": ["cost", "final"]},
    "jaxtwin, float64, final, one thread": {"reductions": ["final"], "workers": 1},
    "jaxtwin, float64, one draw at a time in C": {"one_lane": True},
    "jaxtwin, float64, by JAX alone": {"native": False},
    "jaxtwin, float32": {"precision": "float32"},
    "jaxtwin, float32, cost and final": {"precision": "float32", "reductions": ["cost", "final"]},
}


def measure(quick: bool = False) -> dict[str, Any]:
    """Time a draw, worst error and ratio of each way, for draws around each task; beside them what
    the search of settings gave.

    The error is the largest over channels, samples and the first draws, against Radau at 1e-10.
    """
    changing = [replace(PUBLISHED, inputs=name) for name in INPUTS]
    tasks = (PUBLISHED, *changing, STARTUP, DUAL_CELL)
    return {task.name: around(task, quick) for task in tasks}


def around(task: Task, quick: bool = False) -> dict[str, Any]:
    """The same for one task."""
    checked = 2 if quick or task.inputs != "steps" else 8
    truth = np.stack(on_all_cores(_truth, [(task, number) for number in range(checked)]))
    return _around(task, truth, quick)


def _truth(job: tuple[Task, int]) -> Float[np.ndarray, "t c"]:
    task, number = job
    return reference_readings(task.twins(number + 1)[number], task.drive)


def _around(task: Task, truth: Float[np.ndarray, "d t c"], quick: bool) -> dict[str, Any]:
    searched: dict[str, Any] = {}
    ways: dict[str, tuple[Callable[[], Any], int]] = {}
    for tool, (candidates, few, many) in _candidates(task, quick).items():
        best, searched[tool] = search(task, candidates, max(few, len(truth)), truth)
        count = max(len(truth), many // 16) if quick else many
        ways[f"{tool}, {best}"] = candidates[best](task, count), count
        if best in CVODES:
            cost = cvodes_cost(task, count, CVODES[best])
            ways[f"{tool}, the same, cost alone"] = cost, count
    for name, options in OWN.items():
        count = 256 if quick else 2048
        ways[name] = ours(task, count, **options), count
    return {"ways": _by_turns(ways, truth, quick), "searched": searched}


def _by_turns(
    ways: Mapping[str, tuple[Callable[[], Any], int]],
    truth: Float[np.ndarray, "d t c"],
    quick: bool,
) -> dict[str, dict[str, float | None]]:
    turns = {name: run for name, (run, _) in ways.items()}
    times = rounds(turns, 1 if quick else 4, warm=not quick)
    per_draw = {name: [t / ways[name][1] for t in taken] for name, taken in times.items()}
    return {
        name: {
            "ms_per_draw": 1e3 * float(np.median(per_draw[name])),
            "cpu_ms_per_draw": 1e3 * min(_cpu_seconds(run) for _ in range(3)) / count,
            "error_K": _error(run(), truth),
            "times_ours": median_ratio(per_draw[name], per_draw[OURS]),
            "draws": count,
        }
        for name, (run, count) in ways.items()
    }


def _error(answer: Any, truth: Float[np.ndarray, "d t c"]) -> float | None:
    """The largest, K; None for a way that gives only the cost."""
    if isinstance(answer, jt.simulation.Reductions):
        assert answer.final is not None
        return float(np.abs(answer.final[: len(truth)] - truth[:, -1]).max())
    if answer.ndim == 1:
        return None
    return float(np.abs(answer[: len(truth)] - truth).max())


if __name__ == "__main__":
    run_alone(measure, __doc__)
