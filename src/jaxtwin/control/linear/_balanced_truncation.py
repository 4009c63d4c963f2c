r"""Balanced truncation: reduces a model to the states that matter most between inputs and outputs.

With the Gramians $A P + P A^T + B B^T = 0$ and $A^T Q + Q A + C^T C = 0$, a model is balanced if
both are the same diagonal matrix, of the Hankel singular values $\sigma_i$. The states that are
left out are assumed to be always at rest (singular perturbation), which preserves the DC gain.
The error of the frequency response is at most $2 (\sigma_{r + 1} + ... + \sigma_n)$ (Liu and
Anderson, Int. J. Control 50, 1989). Plain truncation has the same bound but another DC gain.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_continuous_lyapunov

from ...errors import ControlError

# Hankel singular values below this part of the largest are rounding: they belong to states that no
# input moves or no output shows, such as differences between mirror images on a symmetric plate.
NEGLIGIBLE_HANKEL = 1e-11


class Balanced(NamedTuple):
    """A balanced model without the states that no input moves or no output shows; `into` are its
    states by those of the original model."""

    A: Float[np.ndarray, "kept kept"]
    B: Float[np.ndarray, "kept input"]
    C: Float[np.ndarray, "output kept"]
    hankel: Float[np.ndarray, " kept"]
    into: Float[np.ndarray, "kept state"]


def balanced(
    A: Float[np.ndarray, "state state"],
    B: Float[np.ndarray, "state input"],
    C: Float[np.ndarray, "output state"],
) -> Balanced:
    """Computes the balanced form from square roots of the Gramians.

    **Raises:** `ControlError` if the model is not stable.
    """
    slowest = np.linalg.eigvals(A).real.max()
    if not slowest < 0:
        raise ControlError(
            f"reduce: expected a stable model, got a pole with real part {slowest:.3g} 1/s"
        )
    moved = _root(solve_continuous_lyapunov(A, -B @ B.T))
    shown = _root(solve_continuous_lyapunov(A.T, -C.T @ C))
    left, hankel, right = np.linalg.svd(shown.T @ moved)
    kept = hankel > NEGLIGIBLE_HANKEL * hankel[0]
    scale = 1 / np.sqrt(hankel[kept])
    into = scale[:, None] * (left[:, kept].T @ shown.T)
    back = moved @ right[kept].T * scale
    return Balanced(into @ A @ back, into @ B, C @ back, hankel[kept], into)


def residualised(
    model: Balanced, order: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C and D of the model whose states beyond the first ones are always at rest."""
    A, B, C, *_ = model
    kept, left_out = slice(order), slice(order, None)
    rest = np.linalg.solve(A[left_out, left_out], np.hstack([A[left_out, kept], B[left_out]]))
    by_state, by_input = rest[:, :order], rest[:, order:]
    return (
        A[kept, kept] - A[kept, left_out] @ by_state,
        B[kept] - A[kept, left_out] @ by_input,
        C[:, kept] - C[:, left_out] @ by_state,
        -C[:, left_out] @ by_input,
    )


def _root(gramian: np.ndarray) -> np.ndarray:
    """A square root of a matrix that rounding may have given negative eigenvalues."""
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))
