r"""Gains of regulators and of steady-state filters, from discrete algebraic Riccati equations.

The regulator $u = -K x$ minimises $\sum x^T Q x + u^T R u$ with

$$K = (R + B^T P B)^{-1} B^T P A, \quad
P = A^T P A - A^T P B (R + B^T P B)^{-1} B^T P A + Q,$$

and the filter is its dual (Anderson and Moore, *Optimal Filtering*, 1979, chapter 4).
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, solve_discrete_are

from ...errors import ControlError

# A loop counts as stable if the largest absolute value of its poles is below this.
MAX_STABLE_POLE = 1 - 1e-9


def regulator(
    where: str,
    A: Float[np.ndarray, "state state"],
    B: Float[np.ndarray, "state input"],
    Q: Float[np.ndarray, "state state"],
    R: Float[np.ndarray, "input input"],
) -> tuple[Float[np.ndarray, "input state"], Float[np.ndarray, "state state"]]:
    """Computes the gain K, and the matrix P of the cost-to-go.

    **Raises:** `ControlError` if no gain makes the loop stable.
    """
    try:
        P = solve_discrete_are(A, B, Q, R)
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        slowest = np.abs(np.linalg.eigvals(A - B @ K)).max()
    except (LinAlgError, ValueError) as error:
        raise ControlError(_message(where, str(error))) from None
    if not slowest < MAX_STABLE_POLE:
        raise ControlError(_message(where, f"a closed-loop pole at {slowest:.9f} from 0"))
    return K, P


def filter_gain(
    where: str,
    A: Float[np.ndarray, "state state"],
    C: Float[np.ndarray, "output state"],
    process: Float[np.ndarray, "state state"],
    reading: Float[np.ndarray, "output output"],
) -> Float[np.ndarray, "state output"]:
    r"""Computes the gain L of $\hat x_{k|k} = \hat x_{k|k-1} + L (y_k - C \hat x_{k|k-1})$.

    **Arguments:**

    - `process`, `reading`: covariances of the process noise from sample to sample, and of the
      reading noise.

    **Raises:** `ControlError` if no gain makes the error of the filter go to 0.
    """
    _, P = regulator(where, A.T, C.T, process, reading)
    return np.linalg.solve(C @ P @ C.T + reading, C @ P).T


def _message(where: str, reason: str) -> str:
    return (
        f"{where}: expected a model that its inputs can make stable and its outputs show, and "
        f"weights that are not too far apart, got none that has a stable design ({reason}); look "
        "at the model's poles, its DC gain and the deviations"
    )
