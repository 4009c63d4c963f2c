r"""The program of a model predictive controller, condensed to the duty of the horizon.

The states of the next $n$ samples are linear functions of the present states and of the planned
duty, the moves. Eliminating the states leaves a quadratic program whose only unknowns are the
moves. Its matrices are computed once, when a controller is designed.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import block_diag

from ..linear._riccati import regulator
from ._plant import Plant


class Condensed(NamedTuple):
    """The cost as a function of only the moves, `(samples, cells)` in a row: its Hessian, and the
    matrices by which states, last duty and targets enter its gradient."""

    hessian: Float[Array | np.ndarray, "moves moves"]
    by_states: Float[Array | np.ndarray, "moves state"]
    by_last_duty: Float[Array | np.ndarray, "moves cells"]
    by_target: Float[Array | np.ndarray, "moves moves"]


class Deviations(NamedTuple):
    """The accepted deviations of the outputs, K, of the duty, and of its change."""

    output: Float[Array | np.ndarray, " outputs"]
    duty: Float[Array | np.ndarray, " cells"]
    change: Float[Array | np.ndarray, " cells"]


class SoftLimits(NamedTuple):
    """The temperatures of the watched channels in the samples of the horizon, `(samples, channels)`
    in a row, as deviations from the operating point: by the states and by the moves, with their
    limits.

    - `rest_gain`: the temperatures of the channels at rest, K per unit of duty.
    - `C`, `outputs`: the matrix of the channels, and their readings at the operating point, degC.
    - `L`: the gain of the filter of their errors, see `error_gain`.
    - `excess`: the accepted excess, K.
    """

    by_states: Float[Array | np.ndarray, "rows state"]
    by_moves: Float[Array | np.ndarray, "rows moves"]
    lowest: Float[Array | np.ndarray, " rows"]
    highest: Float[Array | np.ndarray, " rows"]
    rest_gain: Float[Array | np.ndarray, "watched cells"]
    C: Float[Array | np.ndarray, "watched state"]
    outputs: Float[Array | np.ndarray, " watched"]
    L: Float[Array | np.ndarray, " watched"]
    excess: Float[Array | np.ndarray, ""]


class PredictedStates(NamedTuple):
    """The states of the samples from 1 to the horizon, as matrices that multiply the present states
    and disturbances, and the moves."""

    by_states: Float[np.ndarray, "samples n state"]
    by_moves: Float[np.ndarray, "samples n moves"]


def predict(plant: Plant, horizon: int) -> PredictedStates:
    """Computes the states over a horizon, given in samples."""
    (n, cells), outputs = plant.B.shape, len(plant.C)
    by_disturbance = plant.B @ plant.inverse @ np.eye(outputs, n + outputs, n)
    state, moved = np.eye(n, n + outputs), np.zeros((n, horizon * cells))
    by_states, by_moves = [], []
    for sample in range(horizon):
        this = np.eye(cells, horizon * cells, sample * cells)
        state = plant.A @ state + by_disturbance
        moved = plant.A @ moved + plant.B @ this
        by_states.append(state)
        by_moves.append(moved)
    return PredictedStates(np.array(by_states), np.array(by_moves))


def condense(plant: Plant, predicted: PredictedStates, deviations: Deviations) -> Condensed:
    r"""Condenses the cost to a function of the moves.

    With $\xi = (x, u_{-1})$, deviations from the point where the plate comes to rest, and the input
    $\Delta u$, the problem is that of a regulator, and the cost beyond the horizon is its Riccati
    cost.

    **Raises:** `ControlError` if the plant has no stable design.
    """
    (n, cells), outputs = plant.B.shape, len(plant.C)
    horizon, _, moves = predicted.by_moves.shape
    y, u, change = (np.asarray(deviation, float) for deviation in deviations)
    unit = np.eye(cells)
    A = np.block([[plant.A, plant.B], [np.zeros((cells, n)), unit]])
    B = np.vstack([plant.B, unit])
    Q = np.asarray(block_diag(plant.C.T @ np.diag(y**-2.0) @ plant.C, np.diag(u**-2.0)))
    _, P = regulator("MPC", A, B, Q, np.diag(change**-2.0))
    # Row k of each: (x_k, u_{k-1}) for k = 1 to the horizon, by the states and by the moves.
    duty = np.eye(moves).reshape(horizon, cells, moves)
    no_states = np.zeros((horizon, cells, n + outputs))
    by_states = np.concatenate([predicted.by_states, no_states], axis=1).reshape(-1, n + outputs)
    E = np.concatenate([predicted.by_moves, duty], axis=1).reshape(-1, moves)
    W = np.asarray(block_diag(*[Q] * (horizon - 1), P))
    disturbance = np.eye(outputs, n + outputs, n)
    aim = np.vstack([plant.rest_states, unit])  # (x, u) at rest per duty
    at_rest = np.vstack([plant.rest_states @ plant.inverse @ disturbance, no_states[0]])
    differences = np.eye(moves) - np.eye(moves, k=-cells)
    S = np.diag(np.tile(change**-2.0, horizon))
    first = np.eye(moves, cells)
    hessian = E.T @ W @ E + differences.T @ S @ differences
    return Condensed(
        hessian=(hessian + hessian.T) / 2,
        by_states=E.T @ W @ (by_states - np.tile(at_rest, (horizon, 1))),
        by_last_duty=-differences.T @ S @ first,
        by_target=-E.T @ W @ np.asarray(block_diag(*[aim] * horizon)),
    )


def rest_cost(
    gain: Float[Array | np.ndarray, "outputs cells"],
    inverse: Float[Array | np.ndarray, "cells outputs"],
    accepted: Float[Array | np.ndarray, " outputs"],
) -> tuple[Float[Array | np.ndarray, "outputs cells"], Float[Array | np.ndarray, "cells cells"]]:
    """Computes the gain at rest in units of the accepted deviations, and the Hessian of the cost of
    a duty at rest, in NumPy or JAX as the arrays are. What no output sees costs as much as what
    they see on average."""
    scaled = gain / accepted[:, None]
    size = (scaled**2).sum() / len(gain)
    unseen = np.eye(gain.shape[1], dtype=gain.dtype) - inverse @ gain
    return scaled, scaled.T @ scaled + size * unseen


def soft_limits(
    plant: Plant,
    predicted: PredictedStates,
    limits: Float[np.ndarray, "watched 2"],
    excess: float,
    L: Float[np.ndarray, " watched"],
) -> SoftLimits:
    """Computes the predicted temperatures of the watched channels, with their limits.

    **Arguments:**

    - `limits`: the lowest and the highest temperature of each watched channel, degC.
    - `excess`: the accepted excess, K.
    - `L`: the gain of the filter of the channels' errors.
    """
    C, (horizon, _, states) = plant.watched, predicted.by_states.shape
    lowest, highest = np.tile((limits - plant.watched_outputs[:, None]).T, horizon)
    return SoftLimits(
        by_states=(C @ predicted.by_states).reshape(-1, states),
        by_moves=(C @ predicted.by_moves).reshape(len(lowest), -1),
        lowest=lowest,
        highest=highest,
        rest_gain=C @ plant.rest_states,
        C=C,
        outputs=plant.watched_outputs,
        L=L,
        excess=np.asarray(excess),
    )
