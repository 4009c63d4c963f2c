"""The single twin that represents a fit if no recording is named."""

from typing import Any

from ..errors import JaxtwinError
from ..physics import Twin, check_twin
from ._fit import Fit


def nominal_twin(where: str, twin: Any, error: type[JaxtwinError]) -> Twin:
    """Returns a twin unchanged, or the `mean_twin` of a fit, with the means of its recordings' own
    values.

    **Arguments:**

    - `where`: the names of the function and of its argument, for the message.
    - `error`: the error to raise.

    **Raises:** `error` if it is neither a twin nor a fit.
    """
    plant = twin.mean_twin if isinstance(twin, Fit) else twin
    check_twin(where, plant, error)
    return plant
