"""The limits of a driven rig and of plausible readings: `[limits]` of a rig file."""

from dataclasses import dataclass
from typing import final

# The melting point of bismuth-tin, the softest solder of ordinary modules, degC: the default limit
# of a cell.
SOLDER = 138.0


@final
@dataclass(frozen=True)
class Limits:
    """Limits of `jaxtwin drive`. A field that is None has a default that follows from the physics.

    **Arguments:**

    - `temperature`: the highest temperature of any channel, K.
    - `cell_temperature`: the highest temperature of both sides of a cell, as the twin predicts
      them, K.
    - `lowest`: the temperature below which a reading is implausible, K.
    - `rate`: the rate above which the change of a reading is implausible, K/s.
    - `frozen`: the time at full duty after which a reading that does not change is implausible, s.
      At a lower duty the time is longer by the same factor.
    - `deviation`: the largest deviation of a reading from the twin's prediction, in addition to
      half of its rise, K.
    - `command_delay`: the longest time until the driver has applied a command, including its ramp,
      s.
    - `stop_on_alarm`: whether an alarm of a monitor switches the cells off, as an interlock does.
    - `relay`: the name of the relay in the supply of the cells, which a device opens; `None` for a
      rig without one.
    """

    temperature: float
    cell_temperature: float | None = None
    lowest: float | None = None
    rate: float | None = None
    frozen: float | None = None
    deviation: float | None = None
    command_delay: float | None = None
    stop_on_alarm: bool = False
    relay: str | None = None
