"""Which twin a design is made for, and a loop is simulated with, where a fit is given."""

from typing import Any

from .._errors import ControlError
from ..matching import Fit
from ..physics import Twin
from ..physics._twin import check_twin


def nominal_twin(where: str, twin: Any) -> Twin:
    """A twin; or that of a fit, with the mean of what its recordings have each for itself.

    **Arguments:**

    - `where`: function and argument, for the message.

    **Raises:** `ControlError` where it is neither.
    """
    plant = twin.mean_twin if isinstance(twin, Fit) else twin
    check_twin(where, plant, ControlError)
    return plant
