"""The result of a validation."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._by_recording import ByRecording
from .._display import aligned, picture
from .._result import AbstractResult, table
from .._statistics import about_mean, fit_text, ljung_box, mean_fit_percent
from ..matching import Band, Fit, estimate_noise
from ..matching._recording_notes import recording_notes
from ..physics import Twin
from ..simulation import Run

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True)
class Whiteness:
    """The result of a test of whiteness of a channel's residuals.

    - `statistic`: $Q$. `lags`: $h$.
    - `p_value`: the probability that white noise has a larger statistic. Below 0.01 the residuals
      contain something that a better model could describe. Beside other channels of a recording it
      is Holm's adjusted value, so that all channels together are called not white in 1 % of
      recordings whose residuals are white, however many channels there are.
    - `autocorrelation_time`: the number of samples with the information of one independent sample.
    """

    statistic: float
    lags: int
    p_value: float
    autocorrelation_time: float

    @property
    def is_white(self) -> bool:
        """Whether the test does not reject whiteness at the level of 1 %."""
        return self.p_value >= 0.01


def whiteness(residuals: Float[np.ndarray, " times"]) -> Whiteness:
    """Ljung and Box's test of equally spaced residuals about their mean; NaN for missing samples.

    **Raises:** `ValueError` for fewer than ten samples.
    """
    test = ljung_box(residuals)
    samples = int(np.count_nonzero(~np.isnan(residuals)))
    return Whiteness(
        *test,
        autocorrelation_time=estimate_noise(
            [about_mean(residuals)[:, None]], samples
        ).autocorrelation_time,
    )


def whiteness_of_channels(residuals: Float[np.ndarray, "times channels"]) -> list[Whiteness]:
    """The tests of the channels of a recording, with Holm's adjusted p-values (Holm 1979), which
    hold whatever the channels have in common.

    **Raises:** `ValueError` for fewer than ten samples in a channel.
    """
    tests = [whiteness(series) for series in residuals.T]
    adjusted = holm_adjusted([test.p_value for test in tests])
    return [replace(test, p_value=p) for test, p in zip(tests, adjusted, strict=True)]


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """The smallest level at which Holm's procedure rejects each of several hypotheses, with the
    probability of any false rejection below that level."""
    order = np.argsort(p_values)
    factors = np.arange(len(order), 0, -1)
    rising = np.maximum.accumulate(factors * np.asarray(p_values, float)[order])
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(rising, 1.0)
    return adjusted.tolist()


@final
class ChannelAccuracy(NamedTuple):
    """The accuracy with which a channel of a recording was predicted.

    - `fit_percent`: %. `rmse`, `mean_error`: K.
    - `coverage`: the part of the samples inside the 95 % band, 0 to 1. `width`: of the band, K. NaN
      without a band.
    - `p_value`, `autocorrelation_time`: of the test of whiteness; the time in s.
    """

    recording: str
    channel: str
    fit_percent: float
    rmse: float
    mean_error: float
    coverage: float
    width: float
    p_value: float
    autocorrelation_time: float

    @property
    def band_texts(self) -> tuple[str, str]:
        """Coverage, %, and width, K, for tables."""
        if math.isnan(self.width):
            return "-", "-"
        return f"{100 * self.coverage:.1f}", f"{self.width:.2f}"


# Number of a `ChannelAccuracy` -> its unit.
UNITS = {
    "fit_percent": "%",
    "rmse": "K",
    "mean_error": "K",
    "coverage": "1",
    "width": "K",
    "p_value": "1",
    "autocorrelation_time": "s",
}

MATCHED_LABEL = "matched, not a prediction: the fit has seen this recording"


@final
@dataclass(frozen=True, repr=False)
class Prediction:
    """The prediction of a recording, or of a part of it, that the match has not seen.

    **Arguments:**

    - `name`: the name of the recording.
    - `run`: the predicted part, with recorded and predicted temperatures.
    - `twin`: the twin that made the prediction.
    - `estimated`: the values that were estimated from the part before it, name -> value.
    - `warnings`: the values that this part does not determine, as text.
    - `fit`: the match on which the prediction is based; None if that was saved earlier.
    - `is_matched`: whether the match has seen the recording, so that nothing is predicted.
    - `make_band`: computes the 95 % band of the run; None for a twin that is not a fit.
    """

    name: str
    run: Run
    twin: Twin
    estimated: Mapping[str, float]
    warnings: tuple[str, ...]
    fit: Fit | None
    is_matched: bool = False
    make_band: Callable[[], Band] | None = None

    @cached_property
    def band(self) -> Band | None:
        """The interval in which 95 % of the readings are expected, computed when it is first used;
        None for a twin that is not a fit."""
        return None if self.make_band is None else self.make_band()

    @property
    def residuals(self) -> Float[np.ndarray, "times channels"]:
        """Recorded minus predicted temperatures, K; NaN for missing samples."""
        assert self.run.experiment.temperatures is not None
        return self.run.experiment.temperatures - self.run.temperatures

    @property
    def sample_time(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.run.time)))

    @cached_property
    def whiteness(self) -> dict[str, Whiteness]:
        """Channel -> test of the whiteness of its residuals."""
        tests = whiteness_of_channels(self.residuals)
        return dict(zip(self.run.channels, tests, strict=True))

    @property
    def _accuracy(self) -> list[ChannelAccuracy]:
        """How well each channel was predicted."""
        unknown = [math.nan] * len(self.run.channels)
        coverage = unknown if self.band is None else self.band.coverage.tolist()
        widths = unknown if self.band is None else self.band.width.tolist()
        fits, tests = self.run.fit_percent.items(), self.whiteness.values()
        columns = zip(fits, self.residuals.T, coverage, widths, tests, strict=True)
        return [
            ChannelAccuracy(
                self.name,
                channel,
                fit,
                float(np.sqrt(np.nanmean(error**2))),
                float(np.nanmean(error)),
                inside,
                width,
                test.p_value,
                test.autocorrelation_time * self.sample_time,
            )
            for (channel, fit), error, inside, width, test in columns
        ]

    def __repr__(self) -> str:
        first, last = self.run.time[0], self.run.time[-1]
        fit = mean_fit_percent(self.run.fit_percent.values())
        what = "Matched recording" if self.is_matched else "Prediction of"
        return f"<{what} {self.name}, {first:g} to {last:g} s: fit {fit:.2f} %>"


@final
@dataclass(frozen=True, repr=False)
class Validation(AbstractResult):
    """Predictions of data that the match has not seen, and their accuracy.

    **Arguments:**

    - `rig`: the name of the rig.
    - `kind`: the data that the match has seen, as text.
    - `predictions`: a prediction for each recording.
    """

    rig: str
    kind: str
    predictions: tuple[Prediction, ...]

    @property
    def fit_percent(self) -> dict[tuple[str, str], float]:
        """(recording, channel) -> NRMSE fit of the predicted part, %."""
        return {
            (prediction.name, channel): value
            for prediction in self.predictions
            for channel, value in prediction.run.fit_percent.items()
        }

    @property
    def mean_fit_percent(self) -> float:
        """Mean over all channels of all recordings that are not constant, %."""
        return mean_fit_percent(self.fit_percent.values())

    @property
    def rmse(self) -> float:
        """Root mean square error over all predicted samples, K."""
        errors = np.concatenate([prediction.residuals.ravel() for prediction in self.predictions])
        return float(np.sqrt(np.nanmean(errors**2)))

    @property
    def bands(self) -> dict[str, Band]:
        """Recording -> the 95 % band of its predicted part; empty for a twin that is not a fit."""
        bands = {part.name: part.band for part in self.predictions}
        return ByRecording({name: band for name, band in bands.items() if band is not None})

    @property
    def coverage(self) -> float:
        """The part of all recorded samples inside the 95 % bands, 0 to 1, to be read beside
        `band_width`; NaN for a twin that is not a fit."""
        bands = self.bands.values()
        counts = [band.run.experiment.sampled.sum(axis=0) for band in bands]
        inside = sum(band.coverage @ count for band, count in zip(bands, counts, strict=True))
        return float(inside / sum(count.sum() for count in counts)) if counts else math.nan

    @property
    def band_width(self) -> float:
        """The mean width of the 95 % bands, K; NaN for a twin that is not a fit."""
        widths = [band.width.mean() for band in self.bands.values()]
        return float(np.mean(widths)) if widths else math.nan

    @property
    def runs(self) -> dict[str, Run]:
        """Recording -> its predicted part."""
        return ByRecording({part.name: part.run for part in self.predictions})

    def summary(self) -> str:
        """The numbers as a text table, with a row for each channel. The part of the samples inside
        the 95 % band stands beside the mean width of the band, without which it says nothing."""
        head = (
            "recording",
            "channel",
            "fit, %",
            "RMSE, K",
            "mean, K",
            "inside, %",
            "95 % band, K",
            "corr. time, s",
            "white?",
        )
        rows = [
            (
                row.recording,
                row.channel,
                fit_text(row.fit_percent),
                f"{row.rmse:.3f}",
                f"{row.mean_error:+.3f}",
                *row.band_texts,
                f"{row.autocorrelation_time:.0f}",
                _verdict(prediction.whiteness[row.channel]),
            )
            for prediction in self.predictions
            for row in prediction._accuracy
        ]
        lines = [
            f"{self.rig}: {self.kind}",
            f"mean fit {self.mean_fit_percent:.2f} %   RMSE {self.rmse:.3f} K{self._said_of_bands}",
            "",
            aligned([head, *rows]),
        ]
        for prediction in self.predictions:
            lines += [f"{prediction.name}: {MATCHED_LABEL}"] * prediction.is_matched
            text = ", ".join(
                f"{name} = {value:.4g}" for name, value in prediction.estimated.items()
            )
            lines += [
                f"{prediction.name}, estimated before {prediction.run.time[0]:g} s: {text}"
            ] * bool(text)
            lines += [f"{prediction.name}: {warning}" for warning in prediction.warnings]
            lines += recording_notes(prediction.run.experiment, prediction.twin)
        return "\n".join(lines)

    def plot(self) -> "Figure":
        """Plots predicted beside recorded temperatures: `jaxtwin.plots.plot_comparison`."""
        return picture("plot_comparison", list(self.runs.values()))

    def to_xarray(self) -> "xarray.Dataset":
        """The columns of `to_dataframe` as a dataset, each (recording, channel), NaN if a recording
        does not have the channel. The runs have their own `to_xarray`."""
        data = self.to_dataframe().to_xarray().assign_attrs(rig=self.rig, kind=self.kind)
        for name, unit in UNITS.items():
            data[name].attrs["units"] = unit
        return data

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each recording and channel, its index, and the columns fit_percent
        (%), rmse (K), mean_error (K), coverage (0 to 1) and width (K) of the 95 % band, p_value and
        autocorrelation_time (s), as in `summary`. Without a fit there is no band: NaN."""
        rows = [row for prediction in self.predictions for row in prediction._accuracy]
        return table(rows, "recording", "channel")

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "kind": self.kind,
            "mean_fit_percent": self.mean_fit_percent,
            "rmse_K": self.rmse,
            "coverage_of_95_percent_bands": self.coverage,
            "band_width_K": self.band_width,
            "recordings": {
                prediction.name: _prediction(prediction) for prediction in self.predictions
            },
        }

    def __repr__(self) -> str:
        return (
            f"<Validation of {self.rig}, {self.kind}: {self.mean_fit_percent:.2f} %, "
            f"RMSE {self.rmse:.3f} K{self._said_of_bands}>"
        )

    @property
    def _said_of_bands(self) -> str:
        if not self.bands:
            return ""
        inside, width = 100 * self.coverage, self.band_width
        return f"   {inside:.1f} % inside 95 % bands of {width:.2f} K mean width"


def _verdict(test: Whiteness) -> str:
    p = f"p = {test.p_value:.2g}" if test.p_value > 1e-99 else "p below 1e-99"
    return f"{'yes' if test.is_white else 'no'} ({p})"


def _prediction(prediction: Prediction) -> dict[str, Any]:
    channels = {}
    for row in prediction._accuracy:
        test = prediction.whiteness[row.channel]
        channels[row.channel] = {
            "fit_percent": row.fit_percent,
            "rmse_K": row.rmse,
            "mean_error_K": row.mean_error,
            "coverage_of_95_percent_band": row.coverage,
            "band_width_K": row.width,
            "ljung_box": test.statistic,
            "lags": test.lags,
            "p_value": test.p_value,
            "autocorrelation_time_samples": test.autocorrelation_time,
        }
    return {
        "from_s": float(prediction.run.time[0]),
        "to_s": float(prediction.run.time[-1]),
        "rmse_K": prediction.run.rmse,
        "is_matched": prediction.is_matched,
        "estimated": prediction.estimated,
        "warnings": prediction.warnings,
        "channels": channels,
    }
