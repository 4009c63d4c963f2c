"""Simple models beside which an identified twin is shown: first order with a delay, and two coupled
capacities."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter


@final
@dataclass(frozen=True, eq=False)
class FirstOrder:
    r"""A first-order system with a delay, $\tau \dot x = \sum_j K_j u_j(t - d) - x$.

    **Arguments:**

    - `time_constant`, `delay`: s.
    - `gains`: of each input, K.
    - `rest`: the temperature without any input, degC.
    - `predicted`: the temperatures over the whole recording, degC.
    """

    time_constant: float
    delay: float
    gains: Float[np.ndarray, " inputs"]
    rest: float
    predicted: Float[np.ndarray, " times"]


def fit_first_order(
    duty: Float[np.ndarray, "times inputs"],
    readings: Float[np.ndarray, " times"],
    known: Bool[np.ndarray, " times"],
    sample_time: float,
) -> FirstOrder:
    """Fits a first-order system with a delay to the known readings of a channel.

    Gains, rest and start are linear for a given time constant and delay, so that least squares
    search only those two.
    """
    count = len(duty)
    known = known & np.isfinite(readings)

    def linear(log_tau: float, delay: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        decay = np.exp(-sample_time / np.exp(log_tau))
        shift = delay / sample_time
        steps = np.arange(count)
        columns = [
            lfilter(
                [0.0, 1 - decay],
                [1.0, -decay],
                np.interp(steps - shift, steps, column, left=column[0]),
            )
            for column in duty.T
        ]
        columns += [np.ones(count), decay**steps]
        basis = np.stack(columns, axis=1)
        # A ridge of a millionth keeps inputs that never change apart.
        solved, *_ = np.linalg.lstsq(basis[known], readings[known], rcond=1e-6)
        return basis, solved, basis @ solved

    def residuals(vector: np.ndarray) -> np.ndarray:
        return (linear(*vector)[2] - readings)[known]

    span = count * sample_time
    lowest, highest = np.log(sample_time / 2), np.log(20 * span)
    starts = [
        (tau, d * span)
        for tau in np.linspace(np.log(2 * sample_time), np.log(2 * span), 12)
        for d in (0.0, 0.01, 0.05)
    ]
    best = min(starts, key=lambda start: float(np.sum(residuals(np.array(start)) ** 2)))
    result = least_squares(
        residuals, best, bounds=([lowest, -1e-9], [highest, 0.3 * span]), x_scale=[0.3, 0.02 * span]
    )
    _, solved, predicted = linear(*result.x)
    return FirstOrder(
        float(np.exp(result.x[0])),
        float(result.x[1]),
        solved[: duty.shape[1]],
        float(solved[-2]),
        predicted,
    )


def fit_two_capacities(
    duty: Float[np.ndarray, "times inputs"],
    readings: Float[np.ndarray, " times"],
    known: Bool[np.ndarray, " times"],
    sample_time: float,
    first: FirstOrder,
) -> Float[np.ndarray, " times"]:
    """Two coupled capacities, the input into both and a room, fitted by SciPy's least squares.

    **Returns:** the predicted temperatures over the whole recording, degC.
    """
    inputs = duty.shape[1]
    known = known & np.isfinite(readings)
    start = readings[np.flatnonzero(np.isfinite(readings))[0]]

    def simulated(vector: np.ndarray) -> np.ndarray:
        rates = np.exp(vector[:4])  # between, from the second, to the room, of the second
        gains, shares = vector[4 : 4 + inputs], vector[4 + inputs : 4 + 2 * inputs]
        room, second = vector[-2:]
        system = np.zeros((3 + inputs, 3 + inputs))
        system[0, :3] = -rates[0] - rates[2], rates[0], rates[2]
        system[1, :3] = rates[1], -rates[1] - rates[3], rates[3]
        system[0, 3:], system[1, 3:] = gains, shares
        step = expm(system * sample_time)
        values, vectors = np.linalg.eig(step[:2, :2])
        forcing = duty @ step[:2, 3:].T + step[:2, 2] * room
        modal = np.linalg.solve(vectors, forcing[:-1].T.astype(complex))
        state = np.linalg.solve(vectors, np.array([start, second], dtype=complex))
        modes = np.stack(
            [
                lfilter([1.0], [1.0, -pole], np.concatenate([[first_state], row]))
                for pole, first_state, row in zip(values, state, modal, strict=True)
            ]
        )
        return np.real(vectors[0] @ modes)

    def residuals(vector: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            errors = (simulated(vector) - readings)[known]
        return np.nan_to_num(errors, nan=1e6, posinf=1e6, neginf=-1e6)

    rate = 1 / first.time_constant
    guess = np.concatenate(
        [
            np.log(rate) + np.array([1.0, -0.5, 0.0, -1.5]),
            first.gains * rate,
            0.1 * first.gains * rate,
            [min(first.rest, start), start],
        ]
    )
    reach = np.concatenate([np.full(4, 7.0), np.full(2 * inputs + 2, np.inf)])
    scale = np.maximum(0.3 * np.abs(guess), 0.1 * rate)
    result = least_squares(
        residuals, guess, bounds=(guess - reach, guess + reach), x_scale=scale, max_nfev=200
    )
    return simulated(result.x)
