"""The law of a controller in C: its code, its numbers, and the fields of its state."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from ...errors import ControlError

LAWS = Path(__file__).with_name("laws")

Table: TypeAlias = tuple[np.ndarray, str]
"""Values of one or two dimensions, and a comment with their meaning and unit."""


class Law(NamedTuple):
    """The law of a controller in C, which `export_c` completes to the controller.

    All names in the code begin with `model_` or `MODEL_`; `export_c` puts the name of the files in
    place of `model`. The code has the functions

    ```c
    static void model_law_init(model_state *state, const model_real *duty,
                               const model_real *measurement);
    static void model_law(model_state *state, const model_real *reference, int samples,
                          model_real *duty);
    ```

    The first sets the state such that the duty goes on where it is. The second computes the duty of
    a sample from the references and the last measurements, `state->seen`; `samples` is the number
    of samples whose references are given, 1 without a horizon. The code may use `MODEL_CELLS`,
    `MODEL_OUTPUTS`, `MODEL_READINGS` (outputs and what is only watched), `MODEL_SAMPLE_TIME_S`,
    `model_lowest_duty[cell]` and `model_highest_duty[cell]`, `model_limited(cell, duty)`, and, with
    `integrals`, `model_integrate(state, i, change)`, which adds to `state->integral[i]` without a
    loss of small changes in `float`.

    - `code`: the code.
    - `title`: what the controller is, for the header. `parameters`: its parameters with units, a
      line for each.
    - `tables`: name -> values and comment of the arrays `model_NAME`.
    - `constants`: name -> number of the macros `MODEL_NAME`; a name that is missing is not defined.
    - `state`: name -> length of the fields of the state that the law needs.
    - `integrals`: the number of integrals; 0 for none.
    - `horizon`: the number of samples whose references the law can use; 0 for a single one.
    """

    code: str
    title: str
    tables: Mapping[str, Table]
    state: Mapping[str, int] = {}
    parameters: Sequence[str] = ()
    constants: Mapping[str, int | float] = {}
    integrals: int = 0
    horizon: int = 0


def bundled_law(file: str) -> str:
    """Reads the C of a law of this package, with the files that it includes."""
    text = (LAWS / file).read_text(encoding="ascii")
    return re.sub(r'#include "(.*)"\n', lambda match: bundled_law(match[1]), text)


def of_cells(name: str, value: object, cells: int) -> Float[np.ndarray, " cells"]:
    """Returns a parameter as an array with a value for each cell.

    **Raises:** `ControlError` if the number of values is neither 1 nor that of the cells.
    """
    result = np.asarray(value, float)
    if result.shape not in ((), (cells,)):
        raise ControlError(
            f"export_c: {name}: expected one value, or one for each of the {cells} cells, got "
            f"{result.tolist()}"
        )
    return np.broadcast_to(result, (cells,)).copy()


def check_designed_cells(designed: int, cells: int) -> None:
    """Refuses a controller that was designed for another number of cells.

    **Raises:** `ControlError`.
    """
    if designed != cells:
        raise ControlError(
            f"export_c: model: expected a controller of the rig's {cells} cells, got one of "
            f"{designed}"
        )


def parameter_text(name: str, value: object, unit: str) -> str:
    """The name, the value or values, and the unit of a parameter as text."""
    return f"{name}: {np.asarray(value, float).tolist()!r} {unit}".rstrip()
