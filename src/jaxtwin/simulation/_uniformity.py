"""How even temperatures are over several places: what a multizone rig is built for."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True, eq=False)
class Uniformity:
    """How even temperatures are over several places, at each time.

    At a time at which one of the temperatures is missing both measures are NaN: the spread over
    other places is another quantity. Such times do not count in the means and the largest.

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
        return _mean(self.spread)

    @property
    def mean_deviation(self) -> float:
        """Over time, K."""
        return _mean(self.deviation)

    @property
    def largest_spread(self) -> float:
        """Over time, K."""
        return float(np.fmax.reduce(self.spread))

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


def _mean(values: Float[np.ndarray, " times"]) -> float:
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else float("nan")
