"""How even temperatures are over several places: what a multizone rig is built for."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True, eq=False)
class Uniformity:
    """How even temperatures are over several places, at each time.

    At a time at which one of the temperatures is missing both measures are NaN: the range over
    other places is another quantity. Such times do not count in the means and the largest.

    **Arguments:**

    - `time`: s.
    - `range`: the highest less the lowest, K.
    - `std`: their standard deviation, K.
    - `places`: names.
    """

    time: Float[np.ndarray, " times"]
    range: Float[np.ndarray, " times"]
    std: Float[np.ndarray, " times"]
    places: tuple[str, ...]

    @property
    def mean_range(self) -> float:
        """Over time, K."""
        return _mean(self.range)

    @property
    def mean_std(self) -> float:
        """Over time, K."""
        return _mean(self.std)

    @property
    def largest_range(self) -> float:
        """Over time, K."""
        return float(np.fmax.reduce(self.range))

    def __repr__(self) -> str:
        return (
            f"<Uniformity of {len(self.places)} places: range {self.mean_range:.2f} K on "
            f"average, {self.largest_range:.2f} K at most>"
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
        range=np.ptp(temperatures, axis=1),
        std=temperatures.std(axis=1),
        places=places,
    )


def _mean(values: Float[np.ndarray, " times"]) -> float:
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else float("nan")
