r"""A steady-state Kalman filter that also estimates disturbances of the plant.

It is the filter of `jaxtwin.observers` for a plant that is linear, when its covariance has come to
rest: correction and prediction are then products with fixed matrices.

The states are those of the plant and, for each output, a disturbance, expressed as the change of
the output at rest, K. The disturbance is a random walk and acts like a duty. The model therefore
agrees with the readings at rest, whatever its error:

$$x_{k+1} = A x_k + B (u_k + G^+ d_k), \quad d_{k+1} = d_k + w_k, \quad y_k = C x_k + v_k$$

with $G$ the DC gain. Of more readings than cells, the disturbances explain what the cells
could have done, and the rest stays unexplained (Pannocchia and Rawlings, AIChE J. 49, 2003, on
disturbance models without offset).
"""

from abc import abstractmethod
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..linear._riccati import filter_gain
from ._law import Table
from ._plant import DesignPlant, Temperatures, checked_plant


class AbstractEstimator(eqx.Module):
    """Estimates the states of a plant, followed by its disturbances, K.

    Duty cycles are deviations from the plant's operating point. What a reading is, an estimator
    says.
    """

    @abstractmethod
    def init(self, duty: Float[Array, " cell"], readings: Float[Array, " reading"]) -> PyTree:
        """The estimate at the start, from the duty until then and the first readings."""

    @abstractmethod
    def update(self, estimate: PyTree, readings: Float[Array, " reading"]) -> PyTree:
        """Corrects a predicted estimate by readings."""

    @abstractmethod
    def states(self, estimate: PyTree) -> Float[Array, " state"]:
        """The states of the plant and its disturbances, K."""

    @abstractmethod
    def predict(self, estimate: PyTree, duty: Float[Array, " cell"]) -> PyTree:
        """Predicts the estimate of the next sample."""


@final
class KalmanFilter(AbstractEstimator):
    """A steady-state Kalman filter. All duty cycles and temperatures are deviations from the
    plant's operating point.

    **Arguments:** the states are those of the plant, followed by the disturbances, K.

    - `A`, `B`, `C`: matrices of these states.
    - `L`: the filter gain.
    - `by_duty`, `by_reading`: the states at rest per unit of duty, and what 1 K of a reading that
      the duty does not explain adds to them.
    """

    A: Float[Array | np.ndarray, "state state"]
    B: Float[Array | np.ndarray, "state cell"]
    C: Float[Array | np.ndarray, "output state"]
    L: Float[Array | np.ndarray, "state output"]
    by_duty: Float[Array | np.ndarray, "state cell"]
    by_reading: Float[Array | np.ndarray, "state output"]

    def init(
        self, duty: Float[Array, " cell"], readings: Float[Array, " output"]
    ) -> Float[Array, " state"]:
        """The states at rest under a duty, with the disturbance that explains the readings."""
        at_rest = jnp.asarray(self.by_duty) @ duty
        return at_rest + jnp.asarray(self.by_reading) @ (readings - self.C @ at_rest)

    def update(
        self, estimate: Float[Array, " state"], readings: Float[Array, " output"]
    ) -> Float[Array, " state"]:
        """Corrects the predicted states by readings."""
        return estimate + self.L @ (readings - self.C @ estimate)

    def states(self, estimate: Float[Array, " state"]) -> Float[Array, " state"]:
        """The estimate itself."""
        return estimate

    def predict(
        self, estimate: Float[Array, " state"], duty: Float[Array, " cell"]
    ) -> Float[Array, " state"]:
        """Predicts the states of the next sample."""
        return jnp.asarray(self.A) @ estimate + jnp.asarray(self.B) @ duty


def error_gain(drift: float, reading_noise: float, sample_time_s: float) -> float:
    r"""Computes the gain of the steady-state Kalman filter of the error of the model at a channel
    that is only watched: $e_{k+1} = e_k + w_k$, read with noise. The error is estimated apart from
    the states, so that a wrong model of the channel does not move the outputs.

    With $q = w^2 h$ and $r$ the variance of a reading, the predicted variance is
    $p = (q + \sqrt{q^2 + 4 q r}) / 2$ and the gain $p / (p + r)$.

    **Arguments:**

    - `drift`: the drift of the error, K per square root of a second.
    - `reading_noise`: the standard deviation of a reading, K.
    """
    q, r = drift**2 * sample_time_s, reading_noise**2
    predicted = (q + np.sqrt(q**2 + 4 * q * r)) / 2
    return float(predicted / (predicted + r))


def kalman_tables(kalman: KalmanFilter, duty: object, outputs: object) -> dict[str, Table]:
    """The numbers of a filter and of its operating point for C. The change of the states in a
    sample, $(A - I) x$, is computed and added there, because slow poles lie near 1."""
    tables = {
        "A": (kalman.A - np.eye(len(kalman.A)), "of the filter: what a sample adds by the states"),
        "B": (kalman.B, "and by the duty"),
        "C": (kalman.C, "its outputs, K"),
        "L": (kalman.L, "of its correction by a reading"),
        "by_duty": (kalman.by_duty, "states at rest by the duty"),
        "by_rest": (kalman.by_reading, "and by a reading, 1/K"),
        "duty": (duty, "operating point, -1 to 1"),
        "at": (outputs, "operating point, degC"),
    }
    return {name: (np.asarray(values, float), text) for name, (values, text) in tables.items()}


def plant_of_filter(
    where: str,
    kalman: KalmanFilter,
    point: tuple[Float[np.ndarray, " cell"], Float[np.ndarray, " output"]],
    watched: Temperatures,
    sample_time_s: float,
    rig: str,
) -> DesignPlant:
    """Makes the plant that a filter of outputs was designed for.

    **Arguments:**

    - `point`: duty and outputs of the operating point.
    """
    A, B, C = (np.asarray(matrix, float) for matrix in (kalman.A, kalman.B, kalman.C))
    states = len(A) - min(B.shape[1], len(C))
    matrices = A[:states, :states], B[:states], C[:, :states]
    none = Temperatures(np.zeros((0, states)), np.zeros(0))
    plant = checked_plant(where, matrices, point, watched, none, sample_time_s)
    return plant._replace(rig=rig)


def kalman_filter(
    where: str,
    plant: DesignPlant,
    drift: Float[np.ndarray, " disturbance"],
    reading_noise: Float[np.ndarray, " reading"],
    sample_time_s: float,
) -> KalmanFilter:
    """Designs the filter.

    **Arguments:**

    - `drift`: the drift of the disturbances, K at rest per square root of a second.
    - `reading_noise`: the standard deviation of each reading, K.

    **Raises:** `ControlError` if no such filter exists.
    """
    states, (cells, unknown) = len(plant.A), plant.disturbed.shape
    unit, zero = np.eye(unknown), np.zeros((unknown, states))
    A = np.block([[plant.A, plant.B @ plant.disturbed], [zero, unit]])
    C = np.hstack([plant.read, np.zeros((len(plant.read), unknown))])
    process = np.zeros((states + unknown, states + unknown))
    process[states:, states:] = np.diag(drift**2 * sample_time_s)
    by_disturbance = np.vstack([plant.rest_states @ plant.disturbed, unit])
    return KalmanFilter(
        A=A,
        B=np.vstack([plant.B, np.zeros((unknown, cells))]),
        C=C,
        L=filter_gain(where, A, C, process, np.diag(reading_noise**2)),
        by_duty=np.vstack([plant.rest_states, np.zeros((unknown, cells))]),
        by_reading=by_disturbance @ np.linalg.pinv(C @ by_disturbance),
    )
