r"""A steady-state Kalman filter that also estimates disturbances of the plant, and the observer of
a twin in its place.

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
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..._arguments import of_kind
from ...errors import ControlError
from ...observers import ExtendedKalmanFilter, MovingHorizonEstimator, MovingHorizonState
from ..linear._operating_point import OperatingPoint
from ..linear._riccati import MAX_STABLE_POLE, filter_gain
from ..linear._state_space import StateSpace
from ._controller import LawTable


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
    - `L`: the filter gain, the change of the states per K.
    - `by_duty`, `by_reading`: the states at rest per unit of duty, and what 1 K of a reading that
      the duty does not explain adds to them.
    - `disturbance_to_duty`: the duty that is equivalent to a disturbance of 1 K, 1/K.
    """

    A: Float[Array | np.ndarray, "state state"]
    B: Float[Array | np.ndarray, "state cell"]
    C: Float[Array | np.ndarray, "output state"]
    L: Float[Array | np.ndarray, "state output"]
    by_duty: Float[Array | np.ndarray, "state cell"]
    by_reading: Float[Array | np.ndarray, "state output"]
    disturbance_to_duty: Float[Array | np.ndarray, "cell disturbance"]

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


def kalman_tables(kalman: KalmanFilter, point: OperatingPoint) -> dict[str, LawTable]:
    """The numbers of a filter and of its operating point for C. The change of the states in a
    sample, $(A - I) x$, is computed and added there, because slow poles lie near 1."""
    tables = {
        "A": (kalman.A - np.eye(len(kalman.A)), "of the filter: what a sample adds by the states"),
        "B": (kalman.B, "and by the duty"),
        "C": (kalman.C, "its outputs, K"),
        "L": (kalman.L, "of its correction by a reading"),
        "by_duty": (kalman.by_duty, "states at rest by the duty"),
        "by_rest": (kalman.by_reading, "and by a reading, 1/K"),
        "duty": (point.duty, "operating point, -1 to 1"),
        "at": (point.outputs, "operating point, degC"),
    }
    return {name: (np.asarray(values, float), text) for name, (values, text) in tables.items()}


def disturbance_to_duty(
    gain: Float[np.ndarray, "reading cell"],
) -> Float[np.ndarray, "cell disturbance"]:
    """The duty that is equivalent to a disturbance of 1 K, 1/K, for at most as many disturbances as
    cells: each moves one reading at rest by 1 K; of more readings than cells, all of them by 1 K in
    the mean square, in the directions that the cells reach.

    **Arguments:**

    - `gain`: the DC gain of the readings, K per unit of duty.
    """
    readings, cells = gain.shape
    if readings <= cells:
        return np.linalg.pinv(gain)
    _, values, directions = np.linalg.svd(gain, full_matrices=False)
    return directions.T / values * np.sqrt(readings)


def kalman_filter(
    where: str,
    read: StateSpace,
    drift: Float[np.ndarray, " disturbance"],
    reading_noise: Float[np.ndarray, " reading"],
) -> KalmanFilter:
    """Designs the filter of a discrete model.

    **Arguments:**

    - `read`: the model; its outputs are the readings.
    - `drift`: the drift of the disturbances, K at rest per square root of a second.
    - `reading_noise`: the standard deviation of each reading, K.

    **Raises:** `ControlError` if no such filter exists.
    """
    assert read.sample_time_s is not None
    matrices, states = _with_disturbances(read), len(read.A)
    process = np.zeros_like(matrices["A"])
    process[states:, states:] = np.diag(drift**2 * read.sample_time_s)
    L = filter_gain(where, matrices["A"], matrices["C"], process, np.diag(reading_noise**2))
    return KalmanFilter(**matrices, L=L)


def filter_with_gain(read: StateSpace, L: Float[np.ndarray, "estimated reading"]) -> KalmanFilter:
    """The filter of a discrete model with a given gain."""
    return KalmanFilter(**_with_disturbances(read), L=L)


def _with_disturbances(read: StateSpace) -> dict[str, Float[np.ndarray, "..."]]:
    """The matrices of a `KalmanFilter`, but for its gain."""
    steady, states = np.asarray(read.steady_states), len(read.A)
    to_duty = disturbance_to_duty(np.asarray(read.C) @ steady)
    cells, unknown = to_duty.shape
    unit, no_duty = np.eye(unknown), np.zeros((unknown, cells))
    C = np.hstack([read.C, np.zeros((len(read.C), unknown))])
    by_disturbance = np.vstack([steady @ to_duty, unit])
    return {
        "A": np.block([[read.A, read.B @ to_duty], [np.zeros((unknown, states)), unit]]),
        "B": np.vstack([read.B, no_duty]),
        "C": C,
        "by_duty": np.vstack([steady, no_duty]),
        "by_reading": by_disturbance @ np.linalg.pinv(C @ by_disturbance),
        "disturbance_to_duty": to_duty,
    }


def is_stable(kalman: KalmanFilter) -> bool:
    """Whether the error of the filter goes to 0."""
    A, L, C = (np.asarray(part) for part in (kalman.A, kalman.L, kalman.C))
    poles = np.linalg.eigvals(A @ (np.eye(len(A)) - L @ C))
    return bool(np.abs(poles).max() < MAX_STABLE_POLE)


# An observer of a twin that knows what the twin does next.
TwinObserver = ExtendedKalmanFilter | MovingHorizonEstimator


class TwinEstimate(NamedTuple):
    """The state of a `TwinEstimator`.

    - `twin`: the state of the observer. `plant`: that of the Kalman filter.
    - `duty`: the last duty, as a deviation from the operating point.
    - `known`: what the twin does beyond the plant, as a change of the outputs at rest, K.
    """

    twin: PyTree
    plant: Float[Array, " state"]
    duty: Float[Array, " cell"]
    known: Float[Array, " disturbance"]


@final
class TwinEstimator(AbstractEstimator):
    r"""Estimates the states of a plant by its Kalman filter, which knows from an observer of the
    twin what the plant lacks. Its readings are those of the filter, and all channels and the room,
    degC; NaN for a room that is not measured.

    The observer estimates the temperatures of all nodes, from which the first states $x$ of the
    plant follow by its projection; the others are commands on their way. What the twin does in the
    next sample beyond the plant under the same duty is known to it: heat that the observer has
    found, a room that is not that of the operating point, values of the twin that have drifted, and
    what is not linear. With $x^+$ the projection of the observer's own prediction,

    $$d = C (I - A)^{-1} (x^+ - A x - B u)$$

    is what it changes of the outputs at rest, K. It is an input of the filter, and a part of the
    disturbance under which a controller plans. The filter estimates the rest from the outputs, and
    so there is no offset, whatever the errors of observer and plant. A regulator on the observer's
    states alone has one: a lasting innovation, such as of heat that the observer takes for an error
    of the camera, moves its states at every sample and never its prediction.

    **Arguments:**

    - `observer`: the observer. `kalman`: the filter.
    - `duty`, `nodes`: the operating point, with the temperatures of the nodes, degC.
    - `projection`: the first states of the plant by the temperatures of the nodes.
    - `to_disturbance`: what a change of the first states in a sample means for the outputs at rest.
    - `parts`: the number of steps of the observer in a sample.
    """

    observer: TwinObserver
    kalman: KalmanFilter
    duty: Float[Array | np.ndarray, " cell"]
    nodes: Float[Array | np.ndarray, " node"]
    projection: Float[Array | np.ndarray, "first node"]
    to_disturbance: Float[Array | np.ndarray, "disturbance first"]
    sample_time_s: float = eqx.field(static=True)
    parts: int = eqx.field(static=True)

    def init(self, duty: Float[Array, " cell"], readings: Float[Array, " reading"]) -> TwinEstimate:
        """The estimate with the plant at rest under the duty."""
        read, channels, _ = self._parts(readings)
        twin = self.observer.init(jnp.mean(channels), duty + self.duty)
        plant = self.kalman.init(duty, read)
        return TwinEstimate(
            twin, plant, duty, jnp.zeros(self.kalman.disturbance_to_duty.shape[1], plant.dtype)
        )

    def update(self, estimate: TwinEstimate, readings: Float[Array, " reading"]) -> TwinEstimate:
        """The estimate that the readings leave."""
        read, channels, room = self._parts(readings)
        twin = self.observer.update(estimate.twin, channels, jnp.isfinite(channels), room)
        latest = twin.latest if isinstance(twin, MovingHorizonState) else twin
        # The outputs are means of channels: one that cannot be spoils them.
        spoilt = latest.is_rejected.any()
        corrected = self.kalman.update(estimate.plant, read)
        plant = jnp.where(spoilt, estimate.plant, corrected)
        first = self._first(twin)
        # The commands on their way are known to the filter.
        states = plant.at[: len(first)].set(first).at[-len(estimate.known) :].set(0.0)
        planned = self.kalman.predict(states, estimate.duty)[: len(first)]
        missed = self._first(self._later(twin, room, estimate.duty)) - planned
        known = jnp.asarray(self.to_disturbance) @ missed
        return TwinEstimate(twin, plant, estimate.duty, known)

    def states(self, estimate: TwinEstimate) -> Float[Array, " state"]:
        """The states of the plant, and the disturbance: what is known and what is found."""
        return estimate.plant.at[-len(estimate.known) :].add(estimate.known)

    def predict(self, estimate: TwinEstimate, duty: Float[Array, " cell"]) -> TwinEstimate:
        """The estimate of the next sample."""
        twin = self.observer.predict(estimate.twin, duty + self.duty, jnp.nan, self.sample_time_s)
        known = jnp.asarray(self.kalman.disturbance_to_duty) @ estimate.known
        plant = self.kalman.predict(estimate.plant, duty + known)
        return estimate._replace(twin=twin, plant=plant, duty=duty)

    def _parts(
        self, readings: Float[Array, " reading"]
    ) -> tuple[Float[Array, " read"], Float[Array, " channels"], Float[Array, ""]]:
        """What the filter reads, the channels, and the room."""
        count = len(self.kalman.C)
        return readings[:count], readings[count:-1], readings[-1]

    def _first(self, twin: PyTree) -> Float[Array, " first"]:
        """The states of the plant that follow from the temperatures of the nodes."""
        return jnp.asarray(self.projection) @ (self.observer.nodes(twin) - self.nodes)

    def _later(self, twin: PyTree, room: Float[Array, ""], duty: Float[Array, " cell"]) -> PyTree:
        """The mean a sample later. A measured room is taken as it is: the observer's own follows
        it slowly, and an error of the sensor moves the duty little."""
        step, command = self.sample_time_s / self.parts, duty + self.duty
        return jax.lax.fori_loop(
            0,
            self.parts,
            lambda _, s: self.observer.predict_mean(s, command, step),
            self.observer.with_room_temperature(twin, room),
        )


def twin_estimator(
    where: str,
    observer: TwinObserver,
    model: StateSpace,
    read: StateSpace,
    kalman: KalmanFilter,
) -> TwinEstimator:
    """The estimator of a controller with an observer of the twin.

    **Arguments:**

    - `observer`: the observer, from `jaxtwin.observers.live_observer`, or a moving-horizon
      estimator with it.
    - `model`: the model for which the controller is designed. `read`: the same with what the filter
      reads as its outputs. `kalman`: that filter.

    **Raises:** `ControlError` if the model does not know the nodes of its rig, or the observer is
    none, is of another rig or does not read all channels.
    """
    expected = "an observer of the rig, such as jaxtwin.observers.live_observer(twin)"
    kinds = ExtendedKalmanFilter, MovingHorizonEstimator
    of_kind(f"{where}: observer", observer, kinds, expected, ControlError)
    point = model.operating_point
    check_observer(where, observer, point.rig)
    if model.projection is None:
        raise ControlError(
            f"{where}: observer: expected none beside a model that was not made by linearize, "
            "because nothing says how its states follow from the temperatures of the rig"
        )
    assert read.sample_time_s is not None
    projection = np.asarray(model.projection)
    at_rest = read.C @ np.linalg.inv(np.eye(len(read.A)) - read.A)
    explained = np.linalg.pinv(read.dcgain @ kalman.disturbance_to_duty)
    return TwinEstimator(
        observer,
        kalman,
        duty=np.asarray(read.operating_point.duty),
        nodes=np.asarray(point.nodes),
        projection=projection,
        to_disturbance=explained @ at_rest[:, : len(projection)],
        sample_time_s=read.sample_time_s,
        parts=max(1, int(np.ceil(read.sample_time_s / observer.longest_seconds - 1e-9))),
    )


def check_observer(where: str, observer: TwinObserver, rig: str) -> None:
    """Refuses an observer of another rig, or of some of its channels.

    **Raises:** `ControlError`.
    """
    twin, columns = observer.model.twin, list(np.asarray(observer.model.columns))
    if twin.rig.name != rig:
        raise ControlError(
            f"{where}: observer: expected one of {rig or 'the rig of the model'}, got one of "
            f"{twin.rig.name}"
        )
    if columns != list(range(len(twin.channels))):
        raise ControlError(
            f"{where}: observer: expected one that reads all {len(twin.channels)} channels of "
            f"{rig}, such as jaxtwin.observers.live_observer(twin), got one that reads "
            f"{len(columns)}"
        )


def refuse_observed(where: str, observed: TwinEstimator | None) -> None:
    """Refuses a controller with an observer where its numbers are to be written.

    **Raises:** `ControlError`.
    """
    if observed is not None:
        raise ControlError(
            f"{where}: expected one without an observer, because a file has no nonlinear twin; "
            "design it with observer=None, and it has the Kalman filter of its linear model"
        )
