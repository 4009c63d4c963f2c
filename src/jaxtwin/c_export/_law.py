"""What distinguishes the C of one kind of controller from that of another."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import ControlError
from ..control._controller import Numbers


class Law(NamedTuple):
    """A control law as C.

    - `kind`: what it is, for the header. `parameter_lines`: its parameters with units, a line each.
    - `integrals`: how many integrals there are; 0 for none.
    - `fields`: of the state beside them and what was seen, name -> length.
    - `tables`: constants, name -> values and comment.
    - `init`: what sets the state, from `duty` and `measurement`; `i` is declared.
    - `step`: body of the function from `state` and `reference` to `duty`; with a horizon, from
      `samples` references in a row.
    - `functions`: what `step` calls. `horizon`: how many references `step` takes; 0 for one alone.
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
    """A parameter of each cell.

    **Raises:** `ControlError` where there is another number of them.
    """
    found = np.asarray(value, float)
    if found.shape not in ((), (cells,)):
        raise ControlError(
            f"export_c: {name}: expected one value, or one for each of the {cells} cells, got "
            f"{found.tolist()}"
        )
    return np.broadcast_to(found, (cells,)).copy()


def parameter_text(name: str, value: Numbers, unit: str) -> str:
    """Name, value or values, and unit."""
    return f"{name}: {np.asarray(value, float).tolist()!r} {unit}".rstrip()
