"""The plant for which a controller is designed: a discrete model with the controller's outputs."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._arguments import of_kind
from ..._jax_settings import is_traced
from ...errors import ControlError
from ...rig import Rig
from ..linear._discrete_model import DiscreteModel, check_at_rest
from ._controller import means_of

# A larger condition number of the DC gain means that all cells move the outputs alike.
MAX_CONDITION = 1e6


class Temperatures(NamedTuple):
    """Temperatures as functions of the states: deviations from `at`, those of the operating point,
    degC."""

    C: Float[np.ndarray, "temperature state"]
    at: Float[np.ndarray, " temperature"]


class NodeProjection(NamedTuple):
    """The first states of a plant by the temperatures of the rig's nodes, less `at`, degC. The
    other states follow from the commands."""

    matrix: Float[np.ndarray, "first node"]
    at: Float[np.ndarray, " node"]


class DesignPlant(NamedTuple):
    """The plant $x_{k+1} = A x_k + B u_k$, $y_k = C x_k$, as deviations from `duty` and `outputs`.

    - `watched`: channels that are read beside the outputs. `points`: temperatures that are to be
      even; with such points the filter reads the watched channels in place of the outputs.
    - `rig`: the name of its rig; empty for that of no rig file.
    - `rest_states`: the states at rest per unit of duty; `gain`: the outputs at rest, K per unit of
      duty; `inverse`: the smallest duty that changes the outputs at rest by 1 K.
    - `read`: C of what the filter reads. `disturbed`: the duty like which a disturbance of 1 K
      acts, at most one for each cell.
    - `projection`: its states by the nodes of the rig; None if they are not known.
    """

    A: Float[np.ndarray, "state state"]
    B: Float[np.ndarray, "state cell"]
    C: Float[np.ndarray, "output state"]
    duty: Float[np.ndarray, " cell"]
    outputs: Float[np.ndarray, " output"]
    watched: Temperatures
    points: Temperatures
    sample_time_s: float
    rest_states: Float[np.ndarray, "state cell"]
    gain: Float[np.ndarray, "output cell"]
    inverse: Float[np.ndarray, "cell output"]
    read: Float[np.ndarray, "reading state"]
    disturbed: Float[np.ndarray, "cell disturbance"]
    rig: str = ""
    projection: NodeProjection | None = None


def check_designed_for(controller: str, designed_for: str, rig: Rig) -> None:
    """Refuses a controller that was designed on a model of another rig.

    **Raises:** `ControlError` with the names of both.
    """
    if designed_for not in ("", rig.name):
        raise ControlError(
            f"{controller}: expected a controller designed on a model of {rig.name}, got one "
            f"designed on a model of {designed_for}"
        )


def plant_of(
    where: str,
    model: Any,
    measured: Sequence[Sequence[str]] | None,
    watched: Sequence[str] = (),
    points: Sequence[str] = (),
) -> DesignPlant:
    """Makes the plant from the duty to means over some channels. A `DesignPlant` is returned
    unchanged.

    A model of reduced order has fast states that are always at rest: its outputs follow the command
    at once. A reading that is taken just before a new command still follows the last command, which
    is therefore a state.

    **Raises:** `ControlError` if the model is not a discrete model with numbers or has no steady
    state, or if there are more outputs than inputs, or all inputs move the outputs alike.
    """
    if isinstance(model, DesignPlant):
        return model
    expected = "a DiscreteModel, such as linearize(...).reduce(4).discretise(1.0)"
    of_kind(f"{where}: model", model, DiscreteModel, expected, ControlError)
    if is_traced(model):
        raise ControlError(
            f"{where}: model: expected numbers, got values that JAX traces; design outside of "
            "jax.jit, jax.vmap and jax.grad"
        )
    check_at_rest(f"{where}: model", model.offset)
    weights = np.vstack(
        [
            means_of(measured, model.output_names),
            means_of([(name,) for name in (*watched, *points)], model.output_names),
        ]
    )
    A, B, C, D = (np.asarray(matrix, float) for matrix in (model.A, model.B, model.C, model.D))
    _check_finite(where, A, B, C, D)
    C, D = weights @ C, weights @ D
    states, inputs = B.shape
    if D.any():
        A = np.block([[A, np.zeros((states, inputs))], [np.zeros((inputs, states + inputs))]])
        B, C = np.vstack([B, np.eye(inputs)]), np.hstack([C, D])
    point, outputs = model.operating_point, len(weights) - len(watched) - len(points)
    last = outputs + len(watched)
    duty = np.broadcast_to(np.asarray(point.duty, float), (inputs,)).copy()
    temperatures = weights @ np.asarray(point.outputs, float)
    plant = checked_plant(
        where,
        (A, B, C[:outputs]),
        (duty, temperatures[:outputs]),
        Temperatures(C[outputs:last], temperatures[outputs:last]),
        Temperatures(C[last:], temperatures[last:]),
        model.sample_time_s,
    )
    projection = None
    if model.projection is not None:
        projection = NodeProjection(np.asarray(model.projection), np.asarray(point.nodes))
    return plant._replace(rig=point.rig, projection=projection)


def checked_plant(
    where: str,
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    point: tuple[np.ndarray, np.ndarray],
    watched: Temperatures,
    points: Temperatures,
    sample_time_s: float,
) -> DesignPlant:
    """Makes a plant from its matrices.

    **Arguments:**

    - `matrices`: A, B and C. `point`: duty and outputs of the operating point.
    - `watched`, `points`: as in `DesignPlant`.

    **Raises:** the errors of `plant_of`.
    """
    A, B, C = matrices
    inputs, outputs = B.shape[1], len(C)
    _check_finite(where, *matrices, *point, *watched, *points)
    if outputs > inputs:
        raise ControlError(
            f"{where}: measured: expected at most as many outputs as the {inputs} cells, got "
            f"{outputs}"
        )
    slow = np.eye(len(A)) - A
    if np.linalg.cond(slow) > 1 / np.finfo(float).eps:
        raise ControlError(
            f"{where}: model: expected one that comes to rest under a constant duty, got a pole "
            "at 1"
        )
    rest_states = np.linalg.solve(slow, B)
    gain, read = C @ rest_states, watched.C if len(points.at) else C
    for of_readings in (gain, read @ rest_states):
        condition = np.linalg.cond(of_readings)
        if not condition < MAX_CONDITION:
            raise ControlError(
                f"{where}: measured: expected outputs that the cells move differently, got a gain "
                f"at rest with condition number {condition:.3g}; measure nearer to the cells"
            )
    return DesignPlant(
        A,
        B,
        C,
        *point,
        watched,
        points,
        sample_time_s,
        rest_states,
        gain,
        inverse=np.linalg.pinv(gain),
        read=read,
        disturbed=_disturbed(read @ rest_states),
    )


def _disturbed(gain: Float[np.ndarray, "reading cell"]) -> Float[np.ndarray, "cell disturbance"]:
    """The duty like which disturbances act: each moves one reading at rest by 1 K; of more readings
    than cells, all of them by 1 K in the mean square, in the directions that the cells reach."""
    readings, cells = gain.shape
    if readings <= cells:
        return np.linalg.pinv(gain)
    _, values, directions = np.linalg.svd(gain, full_matrices=False)
    return directions.T / values * np.sqrt(readings)


def _check_finite(where: str, *arrays: np.ndarray) -> None:
    if not all(np.isfinite(numbers).all() for numbers in arrays):
        raise ControlError(f"{where}: model: expected finite numbers, got some that are not")
