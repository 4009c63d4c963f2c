"""The uniformity of temperatures over several places, for which a multizone rig is built."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True, eq=False)
class Uniformity:
    """The uniformity of temperatures over several places, at each time.

    If one of the temperatures is missing at a time, both measures are NaN there, because the range
    over fewer places is another quantity. The means and the largest range leave out such times.

    **Arguments:**

    - `time`: times, s.
    - `range`: the highest minus the lowest temperature, K.
    - `std`: the standard deviation of the temperatures, K.
    - `places`: the names of the places.
    """

    time: Float[np.ndarray, " times"]
    range: Float[np.ndarray, " times"]
    std: Float[np.ndarray, " times"]
    places: tuple[str, ...]

    @property
    def mean_range(self) -> float:
        """The mean of the range over time, K."""
        return _mean(self.range)

    @property
    def mean_std(self) -> float:
        """The mean of the standard deviation over time, K."""
        return _mean(self.std)

    @property
    def largest_range(self) -> float:
        """The largest range at any time, K."""
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

    - `time`: times, s.
    - `temperatures`: temperatures, `(times, places)`, degC or K.
    - `places`: the names of the places.
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
