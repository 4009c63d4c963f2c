"""How long does a draw take, and how exact is it, with each way of solving the same equations?

python -m benchmarks.ways --quick
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import numpy as np
from jaxtyping import Float

import jaxtwin as jt

from ._casadi import cvodes
from ._measure import median_ratio, on_all_cores, rounds, run_alone
from ._reference import reference_readings
from ._scipy import lsoda
from ._stock_diffrax import kvaerno
from ._task import DUAL_CELL, PUBLISHED, STARTUP, Task

Run = Callable[[], Float[np.ndarray, "d t c"]]
Peer = Callable[[Task, int], Run]

OURS = "jaxtwin, float64"


def peers(task: Task) -> dict[str, tuple[Peer, int]]:
    """Way -> what makes it for some draws, and how many draws are timed."""
    # Which of CVODES' linear solvers measured best: one for symmetric structure, which ignores
    # what the cells' braking makes unsymmetric, or the general one.
    linear = "ldl" if task.twin.wiring.averaging == "voltage" else "qr"
    ways: dict[str, tuple[Peer, int]] = {
        "scipy LSODA, 1e-6": (partial(lsoda, tolerance=1e-6), 8),
        "diffrax Kvaerno3, 1e-5": (partial(kvaerno, diffrax.Kvaerno3(), tolerance=1e-5), 64),
        "diffrax Kvaerno5, 1e-5": (partial(kvaerno, diffrax.Kvaerno5(), tolerance=1e-5), 64),
    }
    for tolerance in (1e-5, 1e-6):
        make = partial(cvodes, tolerance=tolerance, linear_solver=linear)
        ways[f"CasADi CVODES, {tolerance:.0e}".replace("e-0", "e-")] = make, 512
    return ways


def ours(task: Task, count: int, **options: Any) -> Callable[[], Any]:
    """The batch engine."""
    experiment, draws = task.experiment, task.draws(count)

    def run() -> Any:
        return jt.simulate_batch(task.twin, experiment, draws, **options)

    run()
    return run


OWN: dict[str, dict[str, Any]] = {
    OURS: {},
    "jaxtwin, float64, cost and final": {"reductions": ["cost", "final"]},
    "jaxtwin, float32": {"precision": "float32"},
    "jaxtwin, float32, cost and final": {"precision": "float32", "reductions": ["cost", "final"]},
}


def measure(quick: bool = False) -> dict[str, Any]:
    """Time a draw, worst error and ratio of each way, for draws around each task.

    The error is the largest over channels, samples and the first draws, against Radau at 1e-10.
    """
    tasks, checked = (PUBLISHED, STARTUP, DUAL_CELL), 2 if quick else 8
    jobs = [(task, number) for task in tasks for number in range(checked)]
    truth = np.stack(on_all_cores(_truth, jobs)).reshape(len(tasks), checked, 1001, -1)
    return {task.name: _around(task, true, quick) for task, true in zip(tasks, truth, strict=True)}


def _truth(job: tuple[Task, int]) -> Float[np.ndarray, "t c"]:
    task, number = job
    return reference_readings(task.twins(number + 1)[number], task.drive)


def _around(task: Task, truth: Float[np.ndarray, "d t c"], quick: bool) -> dict[str, Any]:
    checked = len(truth)
    ways: dict[str, tuple[Callable[[], Any], int]] = {}
    for name, (make, count) in peers(task).items():
        count = max(checked, count // 16) if quick else count
        ways[name] = make(task, count), count
    for name, options in OWN.items():
        count = 256 if quick else 2048
        ways[name] = ours(task, count, **options), count
    turns = {name: run for name, (run, _) in ways.items()}
    times = rounds(turns, 1 if quick else 4, warm=not quick)
    per_draw = {name: [t / ways[name][1] for t in taken] for name, taken in times.items()}
    table = {}
    for name, (run, count) in ways.items():
        answer = run()
        if isinstance(answer, jt.simulation.Reductions):
            assert answer.final is not None
            error = answer.final[:checked] - truth[:, -1]
        else:
            error = answer[:checked] - truth
        table[name] = {
            "ms_per_draw": 1e3 * float(np.median(per_draw[name])),
            "error_K": float(np.abs(error).max()),
            "times_ours": median_ratio(per_draw[name], per_draw[OURS]),
            "draws": count,
        }
    return table


if __name__ == "__main__":
    run_alone(measure, __doc__)
