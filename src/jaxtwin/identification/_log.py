"""A recording as identification sees it: averaged to a uniform grid that is fine enough to screen
structures."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ..io import Experiment

# The number of samples of a screened recording: more cost time and say little about the structure.
MAX_SCREENED_SAMPLES = 600


@final
@dataclass(frozen=True, eq=False)
class ScreenedLog:
    """A recording on a uniform grid.

    **Arguments:**

    - `experiment`: the averaged recording: between two times, the mean duty; at each, the mean of
      the readings around it, NaN where there are none.
    - `sample_time`: s.
    """

    experiment: Experiment
    sample_time: float

    @property
    def temperatures(self) -> Float[np.ndarray, "times channels"]:
        """Averaged readings, degC."""
        assert self.experiment.temperatures is not None
        return self.experiment.temperatures

    def first_reading(self, channel: int) -> float:
        """The first reading of a channel, degC."""
        column = self.temperatures[:, channel]
        return float(column[np.isfinite(column)][0])


def screened_log(recording: Experiment, samples: int = MAX_SCREENED_SAMPLES) -> ScreenedLog:
    """Averages a recording to at most `samples` samples of one distance."""
    count = min(samples, len(recording.time))
    time = np.linspace(recording.time[0], recording.time[-1], count)
    half = (time[1] - time[0]) / 2
    edges = np.concatenate([[-np.inf], time[:-1] + half, [np.inf]])
    ambient = recording.ambient
    averaged = Experiment(
        time - time[0],
        _held_means(recording.time, np.asarray(recording.duty), time),
        channels=recording.channels,
        cells=recording.cells,
        temperatures=None
        if recording.temperatures is None
        else _bin_means(recording.time, recording.temperatures, edges),
        ambient=None
        if ambient is None
        else _filled(time, _bin_means(recording.time, np.asarray(ambient)[:, None], edges)[:, 0]),
        name=recording.name,
    )
    return ScreenedLog(averaged, 2 * half)


def _held_means(
    time: Float[np.ndarray, " times"],
    values: Float[np.ndarray, "times columns"],
    grid: Float[np.ndarray, " grid"],
) -> Float[np.ndarray, "grid columns"]:
    """The mean of a held signal from each time of a grid to the next."""
    spans = np.diff(time)[:, None]
    integral = np.concatenate(
        [np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * spans, axis=0)]
    )
    at_grid = np.stack([np.interp(grid, time, column) for column in integral.T], axis=1)
    means = np.diff(at_grid, axis=0) / np.diff(grid)[:, None]
    return np.concatenate([means, values[-1:]])


def _bin_means(
    time: Float[np.ndarray, " times"],
    values: Float[np.ndarray, "times columns"],
    edges: Float[np.ndarray, " edges"],
) -> Float[np.ndarray, "bins columns"]:
    """The mean of the present values in each bin, NaN for none."""
    bins = np.searchsorted(edges, time, side="right") - 1
    count = len(edges) - 1
    present = np.isfinite(values)
    sums = np.stack(
        [
            np.bincount(bins, np.where(ok, column, 0.0), count)
            for column, ok in zip(values.T, present.T, strict=True)
        ],
        1,
    )
    numbers = np.stack([np.bincount(bins, ok.astype(float), count) for ok in present.T], 1)
    return np.divide(sums, numbers, out=np.full_like(sums, np.nan), where=numbers > 0)


def _filled(
    time: Float[np.ndarray, " times"], values: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " times"]:
    present = np.isfinite(values)
    return np.interp(time, time[present], values[present])
