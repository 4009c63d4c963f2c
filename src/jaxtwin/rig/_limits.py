"""What a rig may be driven to, and what of its readings is believed: `[limits]` of a rig file."""

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Limits:
    """Limits of `jaxtwin drive`. A field that is None has a default that follows from the physics.

    **Arguments:**

    - `temperature`: of any channel, K.
    - `cell_temperature`: of both sides of a cell as the twin predicts them, K.
    - `lowest`: a reading below it cannot be true, K.
    - `rate`: a reading that changes faster cannot be true, K/s.
    - `frozen`: a reading that stands still for so long while the cells are driven is none, s.
    - `deviation`: of a reading from the twin's prediction, beside half of its rise, K.
    - `command_delay`: by which the driver may obey late, its ramp included, s.
    """

    temperature: float
    cell_temperature: float | None = None
    lowest: float | None = None
    rate: float | None = None
    frozen: float | None = None
    deviation: float | None = None
    command_delay: float | None = None
