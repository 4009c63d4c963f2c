"""The highest temperatures that a schedule may reach."""

import math
from typing import NamedTuple, NoReturn, final

from .._celsius import ZERO_CELSIUS
from ..errors import MatchError
from ..physics import Twin
from ..rig._instruments import SOLDER


@final
class Hottest(NamedTuple):
    """The highest temperature of a channel, and of a cell's side, degC; infinite without limits."""

    reading: float
    side: float

    @classmethod
    def of(cls, twin: Twin, margin: float) -> "Hottest":
        """The limits of a rig less a margin, K."""
        limits = twin.rig.limits
        if limits is None:
            return cls(math.inf, math.inf)
        side = limits.cell_temperature
        of_cells = SOLDER if side is None else side - ZERO_CELSIUS
        return cls(limits.temperature - ZERO_CELSIUS - margin, of_cells - margin)

    def allows(self, reading: float, side: float) -> bool:
        """Whether temperatures are below; those that are not finite are not."""
        return reading <= self.reading and side <= self.side

    def refuse(self, rig: str, coolest: float) -> NoReturn:
        """Says that even the coolest schedule of a rig is too hot.

        **Raises:** `MatchError`.
        """
        raise MatchError(
            f"design_experiment: {rig}: expected {self}, got at least {coolest:.1f} degC; use "
            "other bounds, a smaller margin or a shorter duration"
        )

    def __str__(self) -> str:
        return (
            f"a schedule whose readings stay below {self.reading:g} degC and its cells below "
            f"{self.side:g} degC"
        )
