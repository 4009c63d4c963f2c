"""The linear models on which controllers are designed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...errors import ControlError
from ...rig import Rig
from ..linear._operating_point import OperatingPoint
from ..linear._state_space import StateSpace
from ._controller import means_of

# A larger condition number of the DC gain means that all cells move the outputs alike.
MAX_CONDITION = 1e6


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
    stacked = np.vstack(weights)
    names = [f"y{row + 1}" for row in range(len(stacked))]
    together = model.with_outputs(stacked, names).without_feedthrough()
    A, B, C = (np.asarray(part, float) for part in (together.A, together.B, together.C))
    point, (cells,) = together.operating_point, B.shape[1:]
    duty = np.broadcast_to(np.asarray(point.duty, float), (cells,)).copy()
    ends = np.cumsum([len(rows) for rows in weights])
    assert model.sample_time_s is not None
    first = np.vsplit(C, ends[:-1]), np.split(np.asarray(point.outputs, float), ends[:-1])
    return tuple(
        linear_plant((A, B, rows), duty, at, model.sample_time_s, point.rig)
        for rows, at in zip(*first, strict=True)
    )


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
