"""How far is the default solver, run through `diffrax.diffeqsolve`, from jaxtwin's own loop?

The same exponential step on the same grid, in both loops, and with diffrax's adaptive controller at
the tolerance whose error is next to that of our own loop.

    python -m benchmarks.loops --quick
"""

import os
from collections.abc import Callable
from typing import Any, ClassVar, final

import diffrax
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.simulation import NetworkExponential

from ._measure import median_ratio, on_all_cores, rounds, run_alone
from ._reference import reference_readings
from ._task import DUAL_CELL, PUBLISHED, Task

OWN_LOOP, SAME_GRID = "own loop", "diffeqsolve, same grid"
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6)
"""Of the adaptive controller, relative and in K."""


@final
class OnFixedGrid(diffrax.AbstractSolver):
    """`NetworkExponential` without its error estimate: `simulate_batch` then gives diffrax the grid
    of the own loop.
    """

    inner: NetworkExponential

    term_structure: ClassVar = NetworkExponential.term_structure
    interpolation_cls: ClassVar[Callable[..., Any]] = NetworkExponential.interpolation_cls

    def order(self, terms: Any) -> int:
        """That of the step."""
        return self.inner.order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """The modes of the network."""
        return self.inner.init(terms, t0, t1, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> Any:
        """The step, its error estimate dropped."""
        end, _, dense, state, result = self.inner.step(
            terms, t0, t1, y0, args, solver_state, made_jump
        )
        return end, None, dense, state, result

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The vector field."""
        return self.inner.func(terms, t0, y0, args)


def ways() -> dict[str, dict[str, Any]]:
    """Name -> options of `simulate_batch`."""
    step = NetworkExponential()
    adaptive = {
        f"diffeqsolve, adaptive {tolerance:.0e}".replace("e-0", "e-"): {
            "solver": step,
            "stepsize_controller": diffrax.PIDController(rtol=tolerance, atol=tolerance),
        }
        for tolerance in TOLERANCES
    }
    return {OWN_LOOP: {}, SAME_GRID: {"solver": OnFixedGrid(step)}} | adaptive


def measure(quick: bool = False) -> dict[str, Any]:
    """Milliseconds a draw, times our own loop's, and the largest error against Radau at 1e-10."""
    tasks, checked, draws = (PUBLISHED, DUAL_CELL), 2 if quick else 8, 16 if quick else 256
    jobs = [(task, number) for task in tasks for number in range(checked)]
    truth = np.stack(on_all_cores(_truth, jobs)).reshape(len(tasks), checked, 1001, -1)
    answer: dict[str, Any] = {
        task.name: _table(task, true, draws, 1 if quick else 5)
        for task, true in zip(tasks, truth, strict=True)
    }
    return answer | {"load": os.getloadavg()[0]}


def _truth(job: tuple[Task, int]) -> Float[np.ndarray, "t c"]:
    task, number = job
    return reference_readings(task.twins(number + 1)[number], task.drive)


def _table(
    task: Task, truth: Float[np.ndarray, "d t c"], count: int, turns: int
) -> dict[str, dict[str, float]]:
    experiment, draws = task.experiment, task.draws(count)
    calls = {
        name: lambda options=options: jt.simulate_batch(task.twin, experiment, draws, **options)
        for name, options in ways().items()
    }
    errors = {name: np.abs(call()[: len(truth)] - truth).max() for name, call in calls.items()}
    times = rounds(calls, turns, warm=True)
    return {
        name: {
            "ms_per_draw": 1e3 * float(np.median(taken)) / count,
            "times_own_loop": median_ratio(taken, times[OWN_LOOP]),
            "error_K": float(errors[name]),
        }
        for name, taken in times.items()
    }


if __name__ == "__main__":
    run_alone(measure, __doc__)
