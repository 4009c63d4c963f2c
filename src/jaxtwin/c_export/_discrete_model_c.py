r"""A linear model at sample times as C.

The states that are commands in a delay are shifted, not multiplied. For the others `linear_model.c`
computes the change $(A - I) x + B u$ and adds it: the entries of $A - I$ keep all digits of a
`float` even if a slow pole lies at 0.999.
"""

import numpy as np
from jaxtyping import Float

from ..control import StateSpace
from ._sources import Code, Parts, code_of, comment_block, defines, type_of_numbers


def discrete_model_c(model: StateSpace, name: str, precision: str, origin: str) -> Code:
    """Returns header, source and numbers.

    **Raises:** `ControlError` if a number of the model is not finite in this precision.
    """
    A, B, C, D = (np.asarray(m, float) for m in (model.A, model.B, model.C, model.D))
    states, inputs = B.shape
    moved = _moved_commands(A, B)
    own = states - moved
    tables = {
        "A": (A[:own] - np.eye(states)[:own], "what a step adds by the state, A - I"),
        "B": (B[:own], "and by the duty, K per unit"),
        "C": (C, "temperatures by the state, K per unit"),
        "D": (D, "and by the duty, K per unit"),
        "duty": (np.asarray(model.operating_point.duty, float), "operating point, -1 to 1"),
        "at": (np.asarray(model.operating_point.outputs, float), "operating point, degC"),
    }
    constants = {"MULTIPLIED": own}
    if D.any():
        constants["HAS_DIRECT_GAIN"] = 1
    else:
        del tables["D"]
    sizes = {
        "SAMPLE_TIME_S": model.sample_time_s,
        "STATES": states,
        "INPUTS": inputs,
        "OUTPUTS": len(C),
    }
    parts = Parts(
        _about(model, name, precision, origin),
        type_of_numbers(name, precision) + defines(name, sizes, precision),
        defines(name, constants, precision),
        tables,
        states,
    )
    return code_of("linear_model", name, precision, parts)


def _moved_commands(A: Float[np.ndarray, "n n"], B: Float[np.ndarray, "n inputs"]) -> int:
    """The number of states that are commands in a delay; they are the last ones."""
    states, inputs = B.shape
    shifts = 0
    while (shifts + 1) * inputs < states:
        first = states - (shifts + 1) * inputs
        rows = np.hstack([A[first:], B[first:]])
        expected = np.zeros_like(rows)
        expected[:inputs, states:] = np.eye(inputs)
        later = np.arange(inputs, len(rows))
        expected[later, first + later - inputs] = 1.0
        if np.array_equal(rows, expected):
            return (shifts + 1) * inputs
        shifts += 1
    return 0


def _about(model: StateSpace, name: str, precision: str, origin: str) -> str:
    duty = np.asarray(model.operating_point.duty, float)
    readings = np.asarray(model.operating_point.outputs, float)
    return comment_block(
        [
            f"{name}: a linear model of a thermoelectric rig, written by jaxtwin.",
            f"Coefficients: {origin}" if origin else "Coefficients: a jaxtwin.control.StateSpace",
            "",
            f"Sample time: {model.sample_time_s!r} s. Numbers: {precision}.",
            "Inputs, duty cycles from -1 to 1, positive heats (at the operating point):",
            *(f"  {n}: {u} ({duty[n]:g})" for n, u in enumerate(model.input_names)),
            "Outputs, degC (at the operating point):",
            *(f"  {n}: {y} ({readings[n]:.2f})" for n, y in enumerate(model.output_names)),
            "States, as deviations from the operating point:",
            *(f"  {n}: {x}" for n, x in enumerate(model.state_names)),
        ]
    )
