"""The iterations of a match and the ends of its descents, in the parameters' units."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from ._descent_result import DescentResult, DescentStep
from ._problem import MatchProblem


@final
@dataclass(frozen=True)
class Iteration:
    """One iteration of the optimiser, for Fig. 14 of the paper.

    - `number`: the number of the iteration; 0 is the start. `start`: the number of the start; for
      `match_many` the number of the set, for `profile` the number of the point.
    - `cost`: mean squared error, eq. (11), K^2. `rmse`: its root, K.
    - `gradient`: the largest cosine between the residuals and a column of the Jacobian, 0 at an
      optimum.
    - `accepted`: whether the step was accepted.
    - `values`: parameter -> value; a value of a single recording is `name[recording]`.
    """

    number: int
    start: int
    cost: float
    rmse: float
    gradient: float
    accepted: bool
    values: Mapping[str, float]

    def __str__(self) -> str:
        return f"iteration {self.number}: RMSE {self.rmse:.4f} K"


@final
@dataclass(frozen=True)
class Optimum:
    """The end of the descent from one of several starts.

    - `start`: the number of the start. `cost`: half the sum of squared weighted residuals and
      priors.
    - `apart`: root mean square difference between the simulated channels of this optimum and those
      of the best one, K. Optima with different parameters may predict the same.
    - `rmse`: K. `iterations`, `status`, `converged`: as in `Fit`. `values`: parameter -> value.
    """

    start: int
    cost: float
    apart: float
    rmse: float
    iterations: int
    status: str
    converged: bool
    values: Mapping[str, float]


def make_iteration(problem: MatchProblem, step: DescentStep, start: int) -> Iteration:
    """An iteration of the descent from one of the starts, in the parameters' units."""
    return Iteration(
        number=step.number,
        start=start,
        cost=step.mean_square,
        rmse=float(np.sqrt(step.mean_square)),
        gradient=step.gradient,
        accepted=step.accepted,
        values=problem.labelled(step.vector),
    )


def make_optimum(
    problem: MatchProblem, result: DescentResult, start: int, best: DescentResult
) -> Optimum:
    """The end of the descent from one of the starts, compared with the best."""
    # Padded samples have a difference of 0.
    pairs = zip(result.evaluation.output_errors, best.evaluation.output_errors, strict=True)
    squares = sum(float(np.sum((errors - of_best) ** 2)) for errors, of_best in pairs)
    samples = sum(int(g.lengths.sum()) * g.temperatures.shape[-1] for g in best.objective.groups)
    return Optimum(
        start=start,
        cost=result.cost,
        apart=float(np.sqrt(squares / samples)),
        rmse=float(np.sqrt(result.mean_square)),
        iterations=result.iterations,
        status=result.status,
        converged=result.converged,
        values=problem.labelled(result.vector),
    )
