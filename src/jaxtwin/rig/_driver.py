"""The power driver: one pulse-width modulated H-bridge for each cell."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from jaxtyping import Float

from ._value import Value


@final
@dataclass(frozen=True)
class Driver:
    """Supply and H-bridge.

    **Arguments:**

    - `supply_voltage`: V; without effect on a rig whose heaters all have a given power.
    - `supply_resistance`: the resistance in series with each cell while it is connected, ohm.
    - `on_resistance`: the resistance of the bridge while it is on, ohm.
    - `lag`: the time constant with which the duty cycle that reaches the cells follows the command,
      s; None for no lag.
    - `delay`: the delay of that duty cycle, s; only with a lag.
    - `counts`: the PWM command that means full duty.
    - `polarity`: +1 if positive commands heat the plate, -1 if they cool it.
    - `averaging`: `"voltage"` puts the mean voltage on the cell, `"on-off"` averages the heat flows
      of the connected and the disconnected part of a PWM period.
    - `current_limit`: the largest current that the controller allows through a connected cell, A;
      None for no limit.
    - `states_counts`: whether the rig file states the counts, without which a recording in counts
      has no meaning.
    - `off_phase`: what the bridge does with the cell in the rest of a period: `"brake"` shorts it,
      `"open"` leaves it open.
    """

    supply_voltage: Value
    supply_resistance: Value
    on_resistance: Value
    counts: int = 255
    polarity: Literal[1, -1] = 1
    averaging: Literal["voltage", "on-off"] = "on-off"
    off_phase: Literal["brake", "open"] = "brake"
    lag: Value | None = None
    delay: Value | None = None
    current_limit: Value | None = None
    states_counts: bool = True

    def duty(self, pwm: Sequence[int]) -> Float[np.ndarray, " cells"]:
        """Returns the duty cycles of PWM commands in counts, -1 to 1; positive heats the plate."""
        return np.array(pwm) * self.polarity / self.counts
