"""How even temperatures are over several places: what a multizone rig is built for."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True, eq=False)
class Uniformity:
    """How even temperatures are over several places, at each time.

    **Arguments:**

    - `time`: s.
    - `spread`: the highest less the lowest, K.
    - `deviation`: their standard deviation, K.
    - `places`: names.
    """

    time: Float[np.ndarray, " times"]
    spread: Float[np.ndarray, " times"]
    deviation: Float[np.ndarray, " times"]
    places: tuple[str, ...]

    @property
    def mean_spread(self) -> float:
        """Over time, K."""
        return float(self.spread.mean())

    @property
    def mean_deviation(self) -> float:
        """Over time, K."""
        return float(self.deviation.mean())

    @property
    def largest_spread(self) -> float:
        """Over time, K."""
        return float(self.spread.max())

    def __repr__(self) -> str:
        return (
            f"<Uniformity of {len(self.places)} places: spread {self.mean_spread:.2f} K on "
            f"average, {self.largest_spread:.2f} K at most>"
        )


def uniformity(
    time: Float[np.ndarray, " times"],
    temperatures: Float[np.ndarray, "times places"],
    places: tuple[str, ...],
) -> Uniformity:
    """The uniformity of given temperatures.

    **Arguments:**

    - `time`: s.
    - `temperatures`: degC or K.
    - `places`: their names.
    """
    return Uniformity(
        time=time,
        spread=np.ptp(temperatures, axis=1),
        deviation=temperatures.std(axis=1),
        places=places,
    )
