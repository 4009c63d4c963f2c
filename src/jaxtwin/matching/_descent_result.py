"""The state, the steps and the result of a descent: as the optimiser has them, and as the user
sees them.

`LMState` is what the optimiser carries from trial to trial. `DescentStep` and `DescentResult` hold
the optimiser's vector; `Iteration` and `Optimum` hold the same in the parameters' units.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

from ._jacobian import weighted_jacobian
from ._noise_model import NoiseModel
from ._objective import MatchObjective
from ._problem import MatchProblem
from ._residual_weights import RecordingErrors

Vector = Float[Array, " unknowns"]

RUNNING, GRADIENT, REDUCTION, STEP, STALLED = range(5)
# The meaning of each status of a solver's state.
STATUS = {
    RUNNING: "stopped at the largest number of iterations",
    GRADIENT: "the gradient is zero (within tolerance) in every direction inside the bounds",
    REDUCTION: "the cost falls no further (within tolerance)",
    STEP: "the parameters move no further (within tolerance)",
    STALLED: "no step lowers the cost any more",
}


@final
class Factors(eqx.Module):
    """The QR factorisation of a Jacobian, as far as a step needs it.

    - `triangle`: R. `projected`: $Q^T r$, with the residuals $r$.
    """

    triangle: Float[np.ndarray | Array, "*descents unknowns unknowns"]
    projected: Float[np.ndarray | Array, "*descents unknowns"]

    @property
    def gradient(self) -> Float[np.ndarray | Array, " unknowns"]:
        """$J^T r$, the gradient of half the sum of squares."""
        return self.triangle.T @ self.projected


@final
class LMState(eqx.Module):
    r"""The state of `BoundedLevenbergMarquardt`.

    - `factors`: the factors of the Jacobian at the last accepted vector. `cost`: half the sum of
      squared residuals there. `aux`: the auxiliary output there.
    - `scale`: $D$. `damping`: $\lambda$. `growth`: its factor at the next rejection.
    - `gradient`: the largest cosine between the residuals and a column of the Jacobian that is not
      held.
    - `is_first`: whether nothing has been computed yet. `accepted`: whether the last step was
      accepted.
    - `status`: the reason to stop, see `STATUS`.
    - `num_residuals`, `num_jacobians`: the number of evaluations.
    """

    factors: Factors
    cost: Scalar
    scale: Float[Array, " unknowns"]
    damping: Scalar
    growth: Scalar
    gradient: Scalar
    is_first: Bool[Array, ""]
    accepted: Bool[Array, ""]
    status: Int[Array, ""]
    num_residuals: Int[Array, ""]
    num_jacobians: Int[Array, ""]
    aux: PyTree[Array]


@final
class DescentStep(NamedTuple):
    """One step of a descent.

    - `number`: the number of the step; 0 is the start.
    - `mean_square`: the mean squared error of all samples, K^2.
    - `gradient`: the largest cosine between the residuals and a column of the Jacobian.
    - `accepted`: whether the step was accepted.
    - `vector`: the unknowns after the step.
    """

    number: int
    mean_square: float
    gradient: float
    accepted: bool
    vector: Float[np.ndarray, " unknowns"]


# Called with the number of the descent and its step.
OnStep = Callable[[int, DescentStep], None]


@final
class Evaluation(eqx.Module):
    """The recordings simulated at one vector, before any weighting.

    - `output_errors`: simulated minus recorded temperatures of each batch of recordings, see
      `_residuals`.
    - `jacobians`: their derivatives, see `_jacobian`.
    """

    output_errors: Sequence[Float[np.ndarray | Array, "..."]]
    jacobians: Sequence[Float[np.ndarray | Array, "..."]]


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """The result of a descent.

    - `vector`: the unknowns at the end.
    - `cost`: half the sum of squared weighted residuals. `mean_square`: the mean squared error,
      K^2.
    - `status`: the reason for the end, as text. `converged`: whether the end is an optimum.
    - `steps`: all steps, including those of earlier rounds. `iterations`: their number.
    - `objective`: the function that was minimised. `evaluation`: its evaluation at the vector.
    - `optimiser`: the state from which `BoundedLevenbergMarquardt` can continue; None for other
      solvers.
    """

    vector: Float[np.ndarray, " unknowns"]
    cost: float
    mean_square: float
    status: str
    converged: bool
    steps: tuple[DescentStep, ...]
    iterations: int
    objective: MatchObjective
    evaluation: Evaluation
    optimiser: LMState | None

    def recording_errors(self) -> list[RecordingErrors]:
        """The errors of each recording, split into their parts, K."""
        result: dict[int, RecordingErrors] = {}
        batches = zip(self.objective.same_shape_batches, self.evaluation.output_errors, strict=True)
        for batch, errors in batches:
            for row, position in enumerate(batch.positions):
                weights = batch.weights_of(row)
                channel, common_mode, sizes = weights.split(np.asarray(errors)[row])
                parts = (channel, common_mode, weights.shapes @ sizes)
                times = slice(int(batch.lengths[row]))  # without what fills up their number
                result[position] = RecordingErrors(*(np.asarray(part)[times] for part in parts))
        return [result[position] for position in sorted(result)]

    def temperatures(self) -> list[Float[np.ndarray, "_times _channels"]]:
        """The simulated readings of each recording, degC."""
        result: dict[int, np.ndarray] = {}
        batches = zip(self.objective.same_shape_batches, self.evaluation.output_errors, strict=True)
        for batch, errors in batches:
            simulated = np.asarray(errors) + np.asarray(batch.temperatures)
            for row, position in enumerate(batch.positions):
                result[position] = simulated[row, : int(batch.lengths[row])]
        return [result[position] for position in sorted(result)]

    def jacobian(self) -> Float[np.ndarray, "residuals unknowns"]:
        """Derivatives of the weighted residuals."""
        jacobians = [np.asarray(part) for part in self.evaluation.jacobians]
        return np.asarray(weighted_jacobian(jacobians, self.objective))


# The start of a descent: a vector, or the result of an earlier descent that is continued.
Start = Float[np.ndarray, " unknowns"] | DescentResult


@final
class MatchEstimate(NamedTuple):
    """The result of the last round of a match, and the noise model of its weights."""

    result: DescentResult
    noise_model: NoiseModel


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
    samples = sum(
        int(g.lengths.sum()) * g.temperatures.shape[-1] for g in best.objective.same_shape_batches
    )
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
