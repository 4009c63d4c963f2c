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
from ._plant import DesignPlant


class Condensed(NamedTuple):
    """The cost as a function of only the moves, `(samples, cells)` in a row: its Hessian, and the
    matrices by which states, last duty and targets enter its gradient."""

    hessian: Float[Array | np.ndarray, "moves moves"]
    by_states: Float[Array | np.ndarray, "moves state"]
    by_last_duty: Float[Array | np.ndarray, "moves cells"]
    by_target: Float[Array | np.ndarray, "moves targets"]


class Deviations(NamedTuple):
    """The accepted deviations of the outputs, K, of the duty, and of its change."""

    output: Float[Array | np.ndarray, " outputs"]
    duty: Float[Array | np.ndarray, " cells"]
    change: Float[Array | np.ndarray, " cells"]


class SoftLimits(NamedTuple):
    """The temperatures of the limited channels in the samples of the horizon, `(samples, channels)`
    in a row, as deviations from the operating point: by the states and by the moves, with their
    limits.

    - `rest_gain`: the temperatures of the channels at rest, K per unit of duty.
    """

    by_states: Float[Array | np.ndarray, "rows state"]
    by_moves: Float[Array | np.ndarray, "rows moves"]
    lowest: Float[Array | np.ndarray, " rows"]
    highest: Float[Array | np.ndarray, " rows"]
    rest_gain: Float[Array | np.ndarray, "limited cells"]


class EvenPoints(NamedTuple):
    """The temperatures that are to be even, as `SoftLimits` has those of limited channels.

    - `C`, `at`: their matrix, and their temperatures at the operating point, degC.
    - `beyond`: the same from the mean of the outputs there on, K.
    - `by_errors`: how the errors of the model at the watched channels change them.
    """

    by_states: Float[Array | np.ndarray, "rows state"]
    by_moves: Float[Array | np.ndarray, "rows moves"]
    rest_gain: Float[Array | np.ndarray, "points cells"]
    C: Float[Array | np.ndarray, "points state"]
    at: Float[Array | np.ndarray, " points"]
    beyond: Float[Array | np.ndarray, " points"]
    by_errors: Float[Array | np.ndarray, "points watched"]


class WatchedChannels(NamedTuple):
    """The channels that are read beside the outputs, first those with limits.

    - `C`, `at`: their matrix, and their readings at the operating point, degC.
    - `L`: the gain of the filter of the errors of the model there, see `error_gain`.
    - `unexplained`: what is left of errors there after the disturbances of the Kalman filter. If it
      reads these channels itself, its disturbances take what the cells could have done.
    """

    C: Float[Array | np.ndarray, "watched state"]
    at: Float[Array | np.ndarray, " watched"]
    L: Float[Array | np.ndarray, " watched"]
    unexplained: Float[Array | np.ndarray, "watched watched"]


class PredictedStates(NamedTuple):
    """The states of the samples from 1 to the horizon, as matrices that multiply the present states
    and disturbances, and the moves."""

    by_states: Float[np.ndarray, "samples n state"]
    by_moves: Float[np.ndarray, "samples n moves"]


def predict(plant: DesignPlant, horizon: int, control_horizon: int) -> PredictedStates:
    """Computes the states over a horizon, given in samples. From the last sample of the control
    horizon on, the duty is held."""
    (n, cells), unknown = plant.B.shape, plant.disturbed.shape[1]
    by_disturbance = plant.B @ plant.disturbed @ np.eye(unknown, n + unknown, n)
    state, moved = np.eye(n, n + unknown), np.zeros((n, control_horizon * cells))
    by_states, by_moves = [], []
    for sample in range(horizon):
        move = min(sample, control_horizon - 1)
        this = np.eye(cells, control_horizon * cells, move * cells)
        state = plant.A @ state + by_disturbance
        moved = plant.A @ moved + plant.B @ this
        by_states.append(state)
        by_moves.append(moved)
    return PredictedStates(np.array(by_states), np.array(by_moves))


def condense(
    plant: DesignPlant,
    predicted: PredictedStates,
    deviations: Deviations,
    *,
    tracks_points: bool = False,
) -> Condensed:
    r"""Condenses the cost to a function of the moves.

    With $\xi = (x, u_{-1})$, deviations from the point where the plate comes to rest, and the input
    $\Delta u$, the problem is that of a regulator, and the cost beyond the horizon is its Riccati
    cost.

    **Arguments:**

    - `tracks_points`: whether the cost has the mean square of the deviations of the plant's points
      from their temperatures at rest, too, with the accepted deviation of the outputs.

    **Raises:** `ControlError` if the plant has no stable design.
    """
    (n, cells), unknown = plant.B.shape, plant.disturbed.shape[1]
    horizon, _, moves = predicted.by_moves.shape
    y, u, change = (np.asarray(deviation, float) for deviation in deviations)
    unit = np.eye(cells)
    A = np.block([[plant.A, plant.B], [np.zeros((cells, n)), unit]])
    B = np.vstack([plant.B, unit])
    of_outputs = plant.C.T @ np.diag(y**-2.0) @ plant.C
    if tracks_points:
        of_outputs += plant.points.C.T @ plant.points.C / (len(plant.points.at) * np.mean(y**2))
    Q = np.asarray(block_diag(of_outputs, np.diag(u**-2.0)))
    _, P = regulator("MPC", A, B, Q, np.diag(change**-2.0))
    # Row k of each: (x_k, u_{k-1}) for k = 1 to the horizon, by the states and by the moves.
    held = np.minimum(np.arange(horizon), moves // cells - 1)
    duty = np.eye(moves).reshape(-1, cells, moves)[held]
    no_states = np.zeros((horizon, cells, n + unknown))
    by_states = np.concatenate([predicted.by_states, no_states], axis=1).reshape(-1, n + unknown)
    E = np.concatenate([predicted.by_moves, duty], axis=1).reshape(-1, moves)
    W = np.asarray(block_diag(*[Q] * (horizon - 1), P))
    disturbance = np.eye(unknown, n + unknown, n)
    aim = np.vstack([plant.rest_states, unit])  # (x, u) at rest per duty
    at_rest = np.vstack([plant.rest_states @ plant.disturbed @ disturbance, no_states[0]])
    differences = np.eye(moves) - np.eye(moves, k=-cells)
    S = np.diag(np.tile(change**-2.0, moves // cells))
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
    unseen_costs: bool = True,
) -> tuple[Float[Array | np.ndarray, "outputs cells"], Float[Array | np.ndarray, "cells cells"]]:
    """Computes the DC gain in units of the accepted deviations, and the Hessian of the cost of
    a duty at rest, in NumPy or JAX as the arrays are. What no output sees costs as much as what
    they see on average, or nothing."""
    scaled = gain / accepted[:, None]
    if not unseen_costs:
        return scaled, scaled.T @ scaled
    size = (scaled**2).sum() / len(gain)
    unseen = np.eye(gain.shape[1], dtype=gain.dtype) - inverse @ gain
    return scaled, scaled.T @ scaled + size * unseen


def soft_limits(
    plant: DesignPlant, predicted: PredictedStates, limits: Float[np.ndarray, "limited 2"]
) -> SoftLimits:
    """Computes the predicted temperatures of the limited channels, the first ones of the watched.

    **Arguments:**

    - `limits`: the lowest and the highest temperature of each channel, degC.
    """
    C, at = (part[: len(limits)] for part in plant.watched)
    lowest, highest = np.tile((limits - at[:, None]).T, len(predicted.by_states))
    return SoftLimits(*_over_the_horizon(C, predicted), lowest, highest, C @ plant.rest_states)


def even_points(
    plant: DesignPlant,
    predicted: PredictedStates,
    by_errors: Float[np.ndarray, "points watched"],
) -> EvenPoints:
    """Computes the predicted temperatures of the points that are to be even."""
    C, at = plant.points
    return EvenPoints(
        *_over_the_horizon(C, predicted),
        C @ plant.rest_states,
        C,
        at,
        at - plant.outputs.mean(),
        by_errors,
    )


def _over_the_horizon(
    C: Float[np.ndarray, "temperatures state"], predicted: PredictedStates
) -> tuple[Float[np.ndarray, "rows estimated"], Float[np.ndarray, "rows moves"]]:
    states, moves = predicted.by_states.shape[2], predicted.by_moves.shape[2]
    return (
        (C @ predicted.by_states).reshape(-1, states),
        (C @ predicted.by_moves).reshape(-1, moves),
    )
