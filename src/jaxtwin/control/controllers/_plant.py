"""The plant for which a controller is designed: a discrete model with the controller's outputs."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..._arguments import of_kind
from ..._errors import ControlError
from ..._jax_settings import is_traced
from ...rig import Rig
from ..linear._discrete_model import DiscreteModel, check_at_rest
from ._controller import means_of

LARGEST_CONDITION = 1e6
"""A larger condition number of the gain at rest means that all cells move the outputs alike."""


class Plant(NamedTuple):
    """The plant $x_{k+1} = A x_k + B u_k$, $y_k = C x_k$, as deviations from `duty` and `outputs`.

    - `watched`, `watched_outputs`: C of some channels, and their readings at the operating point.
    - `rig`: the name of its rig; empty for that of no rig file.
    - `rest_states`: the states at rest per unit of duty; `gain`: the outputs at rest, K per unit of
      duty; `inverse`: the smallest duty that changes the outputs at rest by 1 K.
    """

    A: Float[np.ndarray, "state state"]
    B: Float[np.ndarray, "state cell"]
    C: Float[np.ndarray, "output state"]
    duty: Float[np.ndarray, " cell"]
    outputs: Float[np.ndarray, " output"]
    watched: Float[np.ndarray, "watched state"]
    watched_outputs: Float[np.ndarray, " watched"]
    sample_time_s: float
    rest_states: Float[np.ndarray, "state cell"]
    gain: Float[np.ndarray, "output cell"]
    inverse: Float[np.ndarray, "cell output"]
    rig: str = ""


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
) -> Plant:
    """Makes the plant from the duty to means over some channels. A `Plant` is returned unchanged.

    A model of reduced order has fast states that are always at rest: its outputs follow the command
    at once. A reading that is taken just before a new command still follows the last command, which
    is therefore a state.

    **Raises:** `ControlError` if the model is not a discrete model with numbers or has no steady
    state, or if there are more outputs than inputs, or all inputs move the outputs alike.
    """
    if isinstance(model, Plant):
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
            means_of([(name,) for name in watched], model.output_names),
        ]
    )
    A, B, C, D = (np.asarray(matrix, float) for matrix in (model.A, model.B, model.C, model.D))
    _check_finite(where, A, B, C, D)
    C, D = weights @ C, weights @ D
    states, inputs = B.shape
    if D.any():
        A = np.block([[A, np.zeros((states, inputs))], [np.zeros((inputs, states + inputs))]])
        B, C = np.vstack([B, np.eye(inputs)]), np.hstack([C, D])
    point, outputs = model.operating_point, len(weights) - len(watched)
    duty = np.broadcast_to(np.asarray(point.duty, float), (inputs,)).copy()
    temperatures = weights @ np.asarray(point.outputs, float)
    plant = checked_plant(
        where,
        (A, B, C[:outputs]),
        (duty, temperatures[:outputs]),
        (C[outputs:], temperatures[outputs:]),
        model.sample_time_s,
    )
    return plant._replace(rig=point.rig)


def checked_plant(
    where: str,
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
    point: tuple[np.ndarray, np.ndarray],
    watched: tuple[np.ndarray, np.ndarray],
    sample_time_s: float,
) -> Plant:
    """Makes a plant from its matrices.

    **Arguments:**

    - `matrices`: A, B and C. `point`: duty and outputs of the operating point. `watched`: C and
      outputs of the watched channels.

    **Raises:** the errors of `plant_of`.
    """
    A, B, C = matrices
    inputs, outputs = B.shape[1], len(C)
    _check_finite(where, *matrices, *point, *watched)
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
    gain = C @ rest_states
    condition = np.linalg.cond(gain)
    if not condition < LARGEST_CONDITION:
        raise ControlError(
            f"{where}: measured: expected outputs that the cells move differently, got a gain at "
            f"rest with condition number {condition:.3g}; measure nearer to the cells"
        )
    inverse = np.linalg.pinv(gain)
    return Plant(A, B, C, *point, *watched, sample_time_s, rest_states, gain, inverse)


def _check_finite(where: str, *arrays: np.ndarray) -> None:
    if not all(np.isfinite(numbers).all() for numbers in arrays):
        raise ControlError(f"{where}: model: expected finite numbers, got some that are not")
