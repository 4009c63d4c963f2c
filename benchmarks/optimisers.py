"""Our Levenberg-Marquardt against optimistix's own, SciPy's TRF and lmfit on the same residuals.

Two problems: the paper's circuit by eq. (11), and `dual-cell` with priors, the camera's common
error and the weights that a match ends with. All start where the rig file says, with exact
derivatives, float64, until the cost falls by less than 1e-6 of itself. Times are CPU time without
compilation; bounds hold for all but optimistix's own solver, which has none.

    python benchmarks/optimisers.py FOLDER_WITH_RECORDINGS
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lmfit
import numpy as np
import optimistix as optx
import scipy.optimize
from jax.flatten_util import ravel_pytree

from jaxtwin import Experiment, Twin, match, read_recording
from jaxtwin.matching import BoundedLevenbergMarquardt
from jaxtwin.matching._descent import descend
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._jacobian import residual_jacobian
from jaxtwin.matching._objective import MatchObjective, make_objective
from jaxtwin.matching._problem import MatchProblem
from jaxtwin.matching._residuals import residuals

RTOL = 1e-6
LIMIT = 200
"""Iterations at most."""

_residuals = eqx.filter_jit(lambda v, p: ravel_pytree(residuals(v, p)[0])[0])
_jacobian = eqx.filter_jit(residual_jacobian)


class Counted:
    """Residuals and Jacobian for solvers that call Python."""

    def __init__(self, objective: MatchObjective):
        self.objective, self.residuals, self.jacobians = objective, 0, 0

    def fn(self, vector: Any) -> np.ndarray:
        self.residuals += 1
        return np.asarray(_residuals(jnp.asarray(vector), self.objective))

    def jac(self, vector: Any) -> np.ndarray:
        self.jacobians += 1
        return np.array(_jacobian(jnp.asarray(vector), self.objective))  # lmfit writes into it


Result = tuple[np.ndarray, int | str, int | str]
"""Vector, residuals, Jacobians."""


def ours(objective: MatchObjective, problem: MatchProblem) -> Result:
    solver = BoundedLevenbergMarquardt(rtol=RTOL)
    start = problem.unknowns.start()
    (end,) = descend(
        [problem], [objective], solver, [start], problem.unknowns.search_space(), LIMIT
    )
    assert end.optimiser is not None
    return end.vector, int(end.optimiser.num_residuals), int(end.optimiser.num_jacobians)


def optimistix_own(objective: MatchObjective, problem: MatchProblem) -> Result:
    end = _optimistix(jnp.asarray(problem.unknowns.start()), objective)
    steps = int(end.stats["num_steps"])
    return np.asarray(end.value), steps, steps


@eqx.filter_jit
def _optimistix(start: Any, objective: MatchObjective) -> optx.Solution:
    def fn(vector: Any, objective: Any) -> Any:
        return ravel_pytree(residuals(vector, objective)[0])[0]

    return optx.least_squares(
        fn,
        optx.LevenbergMarquardt(rtol=RTOL, atol=RTOL),
        start,
        args=objective,
        options={"jac": "fwd"},
        max_steps=LIMIT,
        throw=False,
    )


def scipy_trf(objective: MatchObjective, problem: MatchProblem) -> Result:
    counted = Counted(objective)
    lower, upper = problem.unknowns.lower(), problem.unknowns.upper()
    end = scipy.optimize.least_squares(
        counted.fn,
        problem.unknowns.start(),
        counted.jac,  # pyright: ignore[reportArgumentType]
        bounds=(lower, upper),
        x_scale="jac",
        ftol=RTOL,
        max_nfev=LIMIT,
    )
    return end.x, counted.residuals, counted.jacobians


def lmfit_leastsq(objective: MatchObjective, problem: MatchProblem) -> Result:
    """MINPACK behind lmfit's bounds (a sine), with our Jacobian in those bounds' variables."""
    counted = Counted(objective)
    names = [f"p{number}" for number in range(problem.unknowns.size)]
    parameters = lmfit.Parameters()
    lower, upper = problem.unknowns.lower(), problem.unknowns.upper()
    for name, value, low, high in zip(names, problem.unknowns.start(), lower, upper, strict=True):
        parameters.add(name, value=value, min=low, max=high)

    def vector(parameters: Any) -> np.ndarray:
        return np.array([parameters[name].value for name in names])

    end = lmfit.minimize(
        lambda p: counted.fn(vector(p)),
        parameters,
        method="leastsq",
        Dfun=lambda p: counted.jac(vector(p)),
        col_deriv=False,
        ftol=RTOL,
        max_nfev=LIMIT,
    )
    found: Any = end
    return vector(found.params), counted.residuals, counted.jacobians


WAYS: dict[str, Callable[[MatchObjective, MatchProblem], Result]] = {
    "ours": ours,
    "optimistix LevenbergMarquardt": optimistix_own,
    "SciPy TRF": scipy_trf,
    "lmfit leastsq": lmfit_leastsq,
}


def compare(rig: str, experiments: list[Experiment]) -> list[str]:
    """Rows of a table for one rig."""
    fit = match(Twin(rig), experiments)
    problem = solution_of(fit).problem
    objective = make_objective(problem, solution_of(fit).noise_model)
    rows = []
    with jax.enable_x64(True):
        for name, way in WAYS.items():
            way(objective, problem)  # compiles
            began = time.process_time()
            vector, counted, jacobians = way(objective, problem)
            used = time.process_time() - began
            cost = 0.5 * float(jnp.sum(_residuals(jnp.asarray(vector), objective) ** 2))
            lower, upper = problem.unknowns.lower(), problem.unknowns.upper()
            outside = int(np.sum((vector < lower - 1e-9) | (vector > upper + 1e-9)))
            counts = f"{jacobians} | {counted}"
            rows.append(f"| {rig} | {name} | {cost:.5g} | {counts} | {used:.1f} | {outside} |")
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    experiments = [read_recording(folder / f"peltierMIMOStepSec{zone}.mat") for zone in "ABC"]
    print("| rig | optimiser | cost reached | Jacobians | residuals | CPU s | outside bounds |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for rig in ("paper-2024", "dual-cell"):
        compare(rig, experiments)


if __name__ == "__main__":
    main()
