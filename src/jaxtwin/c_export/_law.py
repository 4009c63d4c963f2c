"""The part of the C in which the kinds of controllers differ."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import ControlError
from ..control._controller import Numbers


class Law(NamedTuple):
    """A control law as C.

    - `kind`: the kind of the controller, for the header. `parameter_lines`: its parameters with
      units, a line for each.
    - `integrals`: the number of integrals; 0 for none.
    - `fields`: the fields of the state beside the integrals and the last readings, name -> length.
    - `tables`: the constants, name -> values and comment.
    - `init`: the C that sets the state, from `duty` and `measurement`; `i` is declared.
    - `step`: the body of the function from `state` and `reference` to `duty`; with a horizon, from
      `samples` references in a row.
    - `functions`: the functions that `step` calls. `horizon`: the number of references that `step`
      takes; 0 for a single one.
    """

    kind: str
    parameter_lines: list[str]
    integrals: int
    fields: dict[str, int]
    tables: Mapping[str, tuple[np.ndarray, str]]
    init: str
    step: str
    functions: str = ""
    horizon: int = 0


def of_cells(name: str, value: Numbers, cells: int) -> Float[np.ndarray, " cells"]:
    """Returns a parameter as an array with a value for each cell.

    **Raises:** `ControlError` if the number of values is neither 1 nor that of the cells.
    """
    found = np.asarray(value, float)
    if found.shape not in ((), (cells,)):
        raise ControlError(
            f"export_c: {name}: expected one value, or one for each of the {cells} cells, got "
            f"{found.tolist()}"
        )
    return np.broadcast_to(found, (cells,)).copy()


def parameter_text(name: str, value: Numbers, unit: str) -> str:
    """The name, the value or values, and the unit of a parameter as text."""
    return f"{name}: {np.asarray(value, float).tolist()!r} {unit}".rstrip()
