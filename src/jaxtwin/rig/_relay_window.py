"""A relay that switches a heater on and off for shares of a window: time-proportional output."""

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class RelayWindow:
    """A relay, solid-state relay or contactor that gives a heater its duty by the time for which it
    is on in each window.

    At the beginning of a window the on time is chosen: nothing, the whole window, or a time between
    that leaves the relay on and off for its minimum times; of these the one that is nearest to what
    is asked for. The difference is carried to the next window, so that the mean over many windows
    is the duty. A duty of 0 is never on and a full one never off; they leave what is carried as it
    is.

    **Arguments:**

    - `period`: the period of the window, s.
    - `minimum_on`, `minimum_off`: the shortest time for which the relay stays on, or off, s.
    """

    period: float
    minimum_on: float = 0.0
    minimum_off: float = 0.0

    def on_time(self, duty: float, carried: float) -> tuple[float, float]:
        """The time of a window for which the relay is on, from its beginning, and the time that is
        carried to the next one, s.

        **Arguments:**

        - `duty`: the duty at the beginning of the window, 0 to 1.
        - `carried`: the time that the windows before have left over, below 0 where they were on for
          longer than asked.
        """
        if not 0 < duty < 1:
            return (self.period if duty >= 1 else 0.0), carried
        wanted = duty * self.period + carried
        longest = self.period - self.minimum_off
        choices = [0.0, self.period]
        if self.minimum_on <= longest:
            choices.append(min(max(wanted, self.minimum_on), longest))
        on = min(choices, key=lambda choice: abs(choice - wanted))
        return on, wanted - on
