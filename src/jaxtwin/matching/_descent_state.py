"""What a descent by Levenberg-Marquardt knows between two steps."""

from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

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
