"""The single twin that stands for a fit where no recording is named."""

from typing import Any

from .._errors import JaxtwinError
from ..physics import Twin
from ..physics._twin import check_twin
from ._fit import Fit


def nominal_twin(where: str, twin: Any, error: type[JaxtwinError]) -> Twin:
    """A twin; or `Fit.mean_twin`, with the mean of what its recordings have each for itself.

    **Arguments:**

    - `where`: function and argument, for the message.

    **Raises:** `error` where it is neither.
    """
    plant = twin.mean_twin if isinstance(twin, Fit) else twin
    check_twin(where, plant, error)
    return plant
