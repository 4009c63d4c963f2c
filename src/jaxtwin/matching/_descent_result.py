"""Where a descent of the optimiser ended, and how it came there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ._jacobian import weighted_jacobian
from ._levenberg_marquardt import LMState
from ._objective import Objective
from ._recording_errors import RecordingErrors
from ._residual_weights import ResidualWeights, SplitErrors


@final
class DescentStep(NamedTuple):
    """One step of a descent.

    - `number`: 0 is the start.
    - `mean_square`: the mean squared error of all samples, K^2.
    - `gradient`: the largest cosine between the residuals and a column of the Jacobian.
    - `accepted`: whether the step was taken.
    - `vector`: the unknowns after it.
    """

    number: int
    mean_square: float
    gradient: float
    accepted: bool
    vector: Float[np.ndarray, " unknowns"]


OnStep = Callable[[int, DescentStep], None]
"""Called with the number of the descent and its step."""


@final
class Evaluation(eqx.Module):
    """The recordings solved at one vector, before any weights.

    - `output_errors`: simulated less recorded temperatures of each group of recordings, see
      `_residuals`.
    - `jacobians`: their derivatives, see `_jacobian`.
    """

    output_errors: list[Float[Array, "..."]]
    jacobians: list[Float[Array, "..."]]


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """Where a descent ended.

    - `vector`: the unknowns.
    - `cost`: half the sum of squared weighted residuals. `mean_square`: of all samples, K^2.
    - `status`: why it stopped, in words. `converged`: whether at an optimum.
    - `steps`: all of them, those of earlier rounds too. `iterations`: how many.
    - `objective`: what was minimised. `evaluation`: of it at the vector.
    - `optimiser`: the state from which `BoundedLevenbergMarquardt` goes on; None where another
      solver descended.
    """

    vector: Float[np.ndarray, " unknowns"]
    cost: float
    mean_square: float
    status: str
    converged: bool
    steps: tuple[DescentStep, ...]
    iterations: int
    objective: Objective
    evaluation: Evaluation
    optimiser: LMState | None

    def recording_errors(self) -> list[RecordingErrors]:
        """The errors of each recording in their parts, K."""
        found: dict[int, RecordingErrors] = {}
        groups = zip(self.objective.groups, self.evaluation.output_errors, strict=True)
        with own_settings():
            for group, errors in groups:
                split = _split(group.weights, errors)
                channel, common_mode, sizes = (np.asarray(part) for part in split)
                camera = np.einsum("rtk,rk->rt", np.asarray(group.weights.shapes), sizes)
                for row, position in enumerate(group.positions):
                    times = slice(int(group.lengths[row]))  # without what fills up their number
                    parts = (part[row, times] for part in (channel, common_mode, camera))
                    found[position] = RecordingErrors(*parts)
        return [found[position] for position in sorted(found)]

    def temperatures(self) -> list[Float[np.ndarray, "_times _channels"]]:
        """What the twin reads in each recording, degC."""
        found: dict[int, np.ndarray] = {}
        groups = zip(self.objective.groups, self.evaluation.output_errors, strict=True)
        for group, errors in groups:
            simulated = np.asarray(errors) + np.asarray(group.temperatures)
            for row, position in enumerate(group.positions):
                found[position] = simulated[row, : int(group.lengths[row])]
        return [found[position] for position in sorted(found)]

    def jacobian(self) -> Float[np.ndarray, "residuals unknowns"]:
        """Derivatives of the weighted residuals."""
        with own_settings():
            return np.asarray(_jacobian(self.evaluation.jacobians, self.objective))


Start = Float[np.ndarray, " unknowns"] | DescentResult
"""Where a descent begins: at a vector, or where an earlier one ended, which it then continues."""


_jacobian = persistent_jit(weighted_jacobian)


@persistent_jit
def _split(
    weights: ResidualWeights, errors: Float[Array | np.ndarray, "recordings times channels"]
) -> SplitErrors:
    return jax.vmap(lambda weights, error: weights.split(error))(weights, errors)
