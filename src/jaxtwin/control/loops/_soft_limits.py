"""The soft temperature limits that a controller could not keep."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..controllers._controller import TemperatureLimit


class ExceededLimit(NamedTuple):
    """A temperature limit that was exceeded.

    - `channel`: the channel.
    - `limit`: the limit, degC. `excess`: the largest excess, K, negative below a lowest limit.
    - `since`, `until`: the first and the last time when the excess was above the accepted one, s.
    """

    channel: str
    limit: float
    excess: float
    since: float
    until: float

    def after(self, before: "ExceededLimit | None") -> "ExceededLimit":
        """What is known of a limit that was exceeded before too; None for the first time."""
        if before is None:
            return self
        worst = max(self.excess, before.excess, key=abs)
        return before._replace(excess=worst, until=self.until)

    def __str__(self) -> str:
        side = "above" if self.excess > 0 else "below"
        return (
            f"{self.channel} was up to {abs(self.excess):.2f} K {side} its limit of "
            f"{self.limit:g} degC, from {self.since:g} s to {self.until:g} s"
        )


def exceeded_soft_limits(
    limits: Mapping[str, TemperatureLimit],
    channels: Sequence[str],
    time: Float[np.ndarray, " times"],
    temperatures: Float[np.ndarray, "times channels"],
) -> tuple[ExceededLimit, ...]:
    """Finds the limits that the temperatures exceed by more than the accepted excess.

    **Arguments:**

    - `limits`: channel -> limit.
    - `channels`, `time`, `temperatures`: what was read, degC, at which times, s.
    """
    result = []
    for name, (lowest, highest, accepted) in limits.items():
        values = temperatures[:, list(channels).index(name)]
        for limit, excess in ((lowest, values - lowest), (highest, values - highest)):
            beyond = -excess if limit == lowest else excess
            (at,) = np.nonzero(beyond > accepted)
            if len(at):
                worst = at[np.argmax(beyond[at])]
                since, until = float(time[at[0]]), float(time[at[-1]])
                result.append(ExceededLimit(name, limit, float(excess[worst]), since, until))
    return tuple(result)
