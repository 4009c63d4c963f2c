"""How long does a match take, and who else gets there?

    python -m benchmarks.matching --quick

The same residuals, ours, for everyone: three recordings of 15 x 1001 samples in all, the paper's
parameters by their logarithm and one ambient temperature each.
"""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lmfit
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import least_squares

import jaxtwin as jt
from jaxtwin.data import synthetic_recordings
from jaxtwin.matching import make_objective, named_recordings
from jaxtwin.matching._jacobian import residual_jacobian
from jaxtwin.matching._noise_model import initial_noise_model
from jaxtwin.matching._problem import ParameterChoice, choose_unknowns, make_match_problem
from jaxtwin.matching._residuals import residuals

from ._measure import rounds, run_alone, warm_median

OWN = {"T_amb": (0.0, 40.0)}
"""One for each recording."""
LIMIT = 200
"""Iterations at most."""


def measure(quick: bool = False) -> dict[str, Any]:
    """Of `paper-2024`, started at the model file's values.

    **Returns:** `recordings` (real or synthetic), `jacobian` (number of residuals and unknowns,
    seconds) for all 20 parameters, and `matches`: way -> seconds, RMSE (K), evaluations of
    residuals and Jacobians. Finite differences count as evaluations of residuals.
    """
    try:
        paths, kind = jt.find_recordings(), "the authors' three step recordings"
    except jt.JaxtwinError:
        paths, kind = synthetic_recordings(), "the bundled synthetic recordings"
    experiments = [jt.read_recording(path) for path in paths]
    twin = jt.Twin("paper-2024")
    every = [name for name in twin.values if name not in ("T_amb", "T_start")]
    free = [name for name in every if twin.rig.parameters[name].free]
    repeats = 1 if quick else 9
    jacobian = Residuals(twin, experiments, every, {})
    answer = {
        "recordings": kind,
        "jacobian": {
            "residuals": _samples(experiments),
            "unknowns": jacobian.start.size,
            "seconds": warm_median(lambda: jacobian.slope(jacobian.start), repeats),
            "residuals_only_seconds": warm_median(lambda: jacobian(jacobian.start), repeats),
        },
    }
    task = Residuals(twin, experiments, free, OWN)
    ways: dict[str, Callable[[], dict[str, Any]]] = {
        "jaxtwin.match": lambda: _ours(twin, experiments, free),
        "scipy least_squares, our Jacobian": lambda: _scipy(task, task.slope),
        "scipy least_squares, finite differences": lambda: _scipy(task, "2-point"),
        "lmfit leastsq, finite differences": lambda: _lmfit(task),
    }
    matches, first = {}, {}
    for name, way in ways.items():
        began = time.perf_counter()
        matches[name] = way()
        first[name] = time.perf_counter() - began
    for name, times in rounds(ways, 1 if quick else 3).items():
        matches[name] |= {"seconds": median(times), "first_seconds": first[name]}
    return answer | {"unknowns": task.start.size, "matches": matches}


class Residuals:
    """Residuals and their Jacobian as plain functions of a vector, counting their calls."""

    def __init__(
        self,
        twin: jt.Twin,
        experiments: list[jt.Experiment],
        free: list[str],
        own: dict[str, tuple[float, float]],
    ):
        choice = ParameterChoice([*free, *own], per_recording=own, bounds=own)
        unknowns = choose_unknowns(twin, (0,) * len(experiments), choice)
        problem = make_match_problem(twin, named_recordings(twin, experiments), unknowns)
        self._objective = make_objective(problem, initial_noise_model(problem))
        self.start, self.lower, self.upper = unknowns.start(), unknowns.lower(), unknowns.upper()
        self.samples = _samples(experiments)
        self.evaluations = self.jacobians = 0
        self(self.start)  # compiles
        self.slope(self.start)

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        with jax.enable_x64(True):
            return np.asarray(_residuals(jnp.asarray(vector), self._objective))

    def slope(self, vector: np.ndarray) -> np.ndarray:
        self.jacobians += 1
        with jax.enable_x64(True):
            return np.asarray(_slope(jnp.asarray(vector), self._objective))

    def counted(self, solve: Callable[[], np.ndarray]) -> dict[str, Any]:
        """The counts of a solve and the RMSE that it reaches, K."""
        self.evaluations = self.jacobians = 0
        best = solve()
        counts = {"residuals": self.evaluations, "jacobians": self.jacobians}
        return {"rmse_K": float(np.sqrt(np.sum(self(best) ** 2) / self.samples)), **counts}


def _samples(experiments: list[jt.Experiment]) -> int:
    return sum(len(experiment.time) * len(experiment.channels) for experiment in experiments)


@eqx.filter_jit
def _residuals(vector: Any, objective: Any) -> Any:
    return ravel_pytree(residuals(vector, objective)[0])[0]


@eqx.filter_jit
def _slope(vector: Any, objective: Any) -> Any:
    return residual_jacobian(vector, objective)


def _ours(twin: jt.Twin, experiments: list[jt.Experiment], free: list[str]) -> dict[str, Any]:
    fit = jt.match(twin, experiments, free=[*free, *OWN], per_recording=OWN, bounds=OWN)
    accepted = sum(step.accepted for step in fit.history)
    return {"rmse_K": fit.rmse, "residuals": len(fit.history), "jacobians": accepted}


def _scipy(task: Residuals, jacobian: Any) -> dict[str, Any]:
    def solve() -> np.ndarray:
        # A start on a bound is moved inside, as trust-region-reflective wants it.
        box = (task.lower, task.upper)
        start = np.clip(task.start, task.lower + 1e-9, task.upper - 1e-9)
        options: dict[str, Any] = {"jac": jacobian, "x_scale": "jac", "max_nfev": LIMIT}
        return least_squares(task, start, bounds=box, **options).x

    return task.counted(solve)


def _lmfit(task: Residuals) -> dict[str, Any]:
    parameters = lmfit.Parameters()
    for number, value in enumerate(task.start):
        limits = {"min": task.lower[number], "max": task.upper[number]}
        parameters.add(f"p{number}", value=value, **limits)

    def vector(values: lmfit.Parameters) -> np.ndarray:
        return np.array([parameter.value for parameter in values.values()])

    def solve() -> np.ndarray:
        # Here differences count.
        limit = LIMIT * len(task.start)
        found: Any = lmfit.minimize(lambda p: task(vector(p)), parameters, max_nfev=limit)
        return vector(found.params)

    return task.counted(solve)


if __name__ == "__main__":
    run_alone(measure, __doc__)
