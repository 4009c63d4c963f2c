"""The refusal of a rig without a plate by what shows or measures one."""

from ..errors import JaxtwinError
from ._rig import Rig


def check_has_plate(where: str, rig: Rig, error: type[JaxtwinError]) -> None:
    """Refuses a rig that has no plate.

    **Raises:** `error`.
    """
    if not rig.has_plate:
        raise error(f"{where}: expected a rig with a plate, got {rig.name}, which has none")
