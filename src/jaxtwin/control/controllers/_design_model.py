"""Controllers that are designed on a linear model, and the models on which they are."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ...errors import ControlError
from ...rig import Rig
from ..linear._operating_point import OperatingPoint
from ..linear._state_space import StateSpace
from ._controller import means_of
from ._duty_limits import AbstractDutyLimitedController
from ._kalman import AbstractEstimator, KalmanFilter, TwinEstimator, TwinObserver, twin_estimator

# A larger condition number of the DC gain means that all cells move the outputs alike.
MAX_CONDITION = 1e6


Designed = TypeVar("Designed", bound="AbstractModelController")


class AbstractModelController(AbstractDutyLimitedController):
    """A controller with a linear model, whose states an estimator finds."""

    model: eqx.AbstractVar[StateSpace]
    """The model of the outputs."""
    kalman: eqx.AbstractVar[KalmanFilter]
    """Its filter."""
    observed: eqx.AbstractVar[TwinEstimator | None]
    """The filter with what an observer knows, if there is one."""

    @property
    def duty(self) -> Float[Array | np.ndarray, " cells"]:
        """The duty at the operating point."""
        return self.model.operating_point.duty

    @property
    def outputs(self) -> Float[Array | np.ndarray, " outputs"]:
        """The outputs at the operating point, degC."""
        return self.model.operating_point.outputs

    @property
    def estimator(self) -> AbstractEstimator:
        """What estimates the states: the Kalman filter, alone or with an observer."""
        return self.kalman if self.observed is None else self.observed

    @property
    def reads_room(self) -> bool:
        """True with an observer, to which a measured room is a reading."""
        return self.observed is not None


def with_observer(
    controller: Designed, observer: TwinObserver | None, model: StateSpace, read: StateSpace
) -> Designed:
    """The controller with an observer of the twin; the controller itself without one.

    **Arguments:**

    - `model`: the model for which it was designed. `read`: the same with what its filter reads.

    **Raises:** the errors of `twin_estimator`.
    """
    if observer is None:
        return controller
    name = type(controller).__name__
    return replace(
        controller, observed=twin_estimator(name, observer, model, read, controller.kalman)
    )


def outputs_of(
    model: StateSpace, *groups: Sequence[Sequence[str]] | None
) -> tuple[StateSpace, ...]:
    """The model with means over channels as its outputs, once for each of several sets of outputs.
    All have the same states, among them the last command if an output follows it at once.

    **Arguments:**

    - `groups`: the channels of each output of a set; None for the mean over all channels.

    **Raises:** `ControlError` for an unknown channel.
    """
    weights = [means_of(measured, model.output_names) for measured in groups]
    stacked, ends = np.vstack(weights), np.cumsum([len(rows) for rows in weights])[:-1]
    names = [f"y{row + 1}" for row in range(len(stacked))]
    together = model.with_outputs(stacked, names).without_feedthrough()
    C, at = np.asarray(together.C), np.asarray(together.operating_point.outputs)
    sets = zip(np.vsplit(C, ends), np.split(at, ends), strict=True)
    return tuple(with_temperatures(together, *rows) for rows in sets)


def with_temperatures(
    model: StateSpace, C: Float[np.ndarray, "rows state"], at: Float[np.ndarray, " rows"]
) -> StateSpace:
    """The states of a discrete model with other temperatures as its outputs.

    **Arguments:**

    - `C`, `at`: the rows of the model, and the temperatures at the operating point, degC.
    """
    A, B, point = np.asarray(model.A), np.asarray(model.B), model.operating_point
    assert model.sample_time_s is not None
    return linear_plant((A, B, C), np.asarray(point.duty), at, model.sample_time_s, point.rig)


def linear_plant(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    duty: Float[np.ndarray, " cells"],
    outputs: Float[np.ndarray, " outputs"],
    sample_time_s: float,
    rig: str,
) -> StateSpace:
    """A discrete model of its matrices A, B and C, and of what the file of a controller keeps of
    the operating point: duty and outputs, degC.

    **Arguments:**

    - `rig`: the name of the rig; empty for that of no rig file.
    """
    A, B, C = matrices
    return StateSpace(
        A,
        B,
        C,
        np.zeros((len(C), B.shape[1])),
        sample_time_s=sample_time_s,
        operating_point=OperatingPoint(duty, np.zeros(0), outputs, np.zeros(()), rig=rig),
    )


def check_plant(where: str, plant: StateSpace, read: StateSpace) -> None:
    """Refuses a plant without a controller of its outputs, or a filter of the readings.

    **Arguments:**

    - `plant`: the model with the outputs that follow references. `read`: the same with what a
      Kalman filter reads.

    **Raises:** `ControlError` if there are more outputs than inputs, numbers that are not finite,
    no steady state, or outputs that all inputs move alike.
    """
    outputs, inputs = np.shape(plant.D)
    for model in (plant, read):
        point = model.operating_point
        numbers = model.A, model.B, model.C, point.duty, point.outputs
        if not all(np.isfinite(part).all() for part in numbers):
            raise ControlError(f"{where}: model: expected finite numbers, got some that are not")
    if outputs > inputs:
        raise ControlError(
            f"{where}: measured: expected at most as many outputs as the {inputs} cells, got "
            f"{outputs}"
        )
    if np.linalg.cond(np.eye(len(plant.A)) - plant.A) > 1 / np.finfo(float).eps:
        raise ControlError(
            f"{where}: model: expected one that comes to rest under a constant duty, got a pole "
            "at 1"
        )
    for gain in (plant.dcgain, read.dcgain):
        condition = np.linalg.cond(np.asarray(gain))
        if not condition < MAX_CONDITION:
            raise ControlError(
                f"{where}: measured: expected outputs that the cells move differently, got a gain "
                f"at rest with condition number {condition:.3g}; measure nearer to the cells"
            )


def check_designed_for(controller: str, designed_for: str, rig: Rig) -> None:
    """Refuses a controller that was designed on a model of another rig.

    **Raises:** `ControlError` with the names of both.
    """
    if designed_for not in ("", rig.name):
        raise ControlError(
            f"{controller}: expected a controller designed on a model of {rig.name}, got one "
            f"designed on a model of {designed_for}"
        )
