"""What was expected of readings, with bands."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Bool, Float

from .._display import html_table, picture
from .._normal_distribution import QUANTILE_975

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, repr=False, eq=False)
class Forecast:
    """Expected readings with the bands in which 95 % of them lie.

    **Arguments:**

    - `name`: the name of the recording.
    - `lead`: the time between what was known and what was expected, s; NaN if it differs from time
      to time.
    - `time`: the times of the readings, s. `channels`: their names.
    - `mean`, `spread`: the mean of each reading, degC, and its standard deviation, K, with the
      errors and the noise of readings.
    - `recorded`: what was read, degC, NaN where nothing was; None for a time that is to come.
    """

    name: str
    lead: float
    time: Float[np.ndarray, " times"]
    channels: tuple[str, ...]
    mean: Float[np.ndarray, "times channels"]
    spread: Float[np.ndarray, "times channels"]
    recorded: Float[np.ndarray, "times channels"] | None

    @property
    def lower(self) -> Float[np.ndarray, "times channels"]:
        """The lower edges of the bands, degC."""
        return self.mean - QUANTILE_975 * self.spread

    @property
    def upper(self) -> Float[np.ndarray, "times channels"]:
        """The upper edges of the bands, degC."""
        return self.mean + QUANTILE_975 * self.spread

    @property
    def band_width(self) -> float:
        """The mean width of the bands, K."""
        return float(2 * QUANTILE_975 * self.spread.mean())

    @property
    def residuals(self) -> Float[np.ndarray, "times channels"]:
        """Recorded minus expected readings, K; NaN where nothing was recorded."""
        if self.recorded is None:
            return np.full(self.mean.shape, math.nan)
        return self.recorded - self.mean

    @property
    def rmse(self) -> float:
        """The root mean square of the residuals, K; NaN if nothing was recorded."""
        there = self.residuals[np.isfinite(self.residuals)]
        return float(np.sqrt(np.mean(there**2))) if there.size else math.nan

    @property
    def coverage(self) -> float:
        """The part of the readings inside the bands, 0 to 1, to be read beside `band_width`; NaN if
        nothing was recorded."""
        inside = self._inside[np.isfinite(self.residuals)]
        return float(inside.mean()) if inside.size else math.nan

    @property
    def _inside(self) -> Bool[np.ndarray, "times channels"]:
        """Whether each reading is inside its band; false where nothing was recorded."""
        return np.abs(self.residuals) <= QUANTILE_975 * self.spread

    def after(self, time: float) -> "Forecast":
        """The part from a time on."""
        kept = self.time >= time
        return Forecast(
            self.name,
            self.lead,
            self.time[kept],
            self.channels,
            self.mean[kept],
            self.spread[kept],
            None if self.recorded is None else self.recorded[kept],
        )

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: mean, lower, upper and, if there is any, recorded, all
        (time, channel) in degC, and spread in K."""
        import xarray

        dims, celsius = ("time", "channel"), {"units": "degC"}
        variables: dict[str, Any] = {
            "mean": (dims, self.mean, celsius),
            "lower": (dims, self.lower, celsius),
            "upper": (dims, self.upper, celsius),
            "spread": (dims, self.spread, {"units": "K"}),
        }
        if self.recorded is not None:
            variables["recorded"] = (dims, self.recorded, celsius)
        return xarray.Dataset(
            variables,
            {"time": ("time", self.time, {"units": "s"}), "channel": list(self.channels)},
            {"recording": self.name, "lead_s": self.lead},
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each time and channel, and the columns of `to_xarray`."""
        return self.to_xarray().to_dataframe()

    def plot(self) -> "Figure":
        """Draws what was expected with its bands, a panel for each channel, and what was read.

        **Returns:** the figure.
        """
        return picture("plot_forecast", self)

    def __repr__(self) -> str:
        text = f"<Forecast of {self.name or 'a recording'}"
        if math.isfinite(self.lead):
            text += f", {self.lead:g} s ahead"
        if math.isfinite(self.rmse):
            text += f": RMSE {self.rmse:.3f} K, {100 * self.coverage:.1f} % inside"
        return f"{text}, bands of {self.band_width:.2f} K>"

    def _repr_html_(self) -> str:
        rows = []
        for number, channel in enumerate(self.channels):
            one = self.residuals[:, number]
            there = np.isfinite(one)
            inside = self._inside[there, number]
            error = f"{np.sqrt(np.mean(one[there] ** 2)):.3f}" if there.any() else ""
            share = f"{100 * inside.mean():.1f}" if there.any() else ""
            width = f"{2 * QUANTILE_975 * self.spread[:, number].mean():.2f}"
            rows.append((channel, error, share, width))
        return html_table(repr(self)[1:-1], ("channel", "RMSE, K", "inside, %", "band, K"), rows)
