"""A recording that was followed by an observer."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._arguments import finite_number
from .._compilation import persistent_jit
from .._display import picture
from .._jax_settings import own_settings
from .._padded_rows import first_rows, padded_rows
from .._result import AbstractResult, table
from ..errors import ObserverError
from ..io import Experiment
from ..simulation import input_levels
from ._estimates import Estimates, Moments, moments
from ._filter_run import (
    MIN_SAMPLES,
    Filtered,
    FilterSamples,
    moments_of,
    samples_between,
)
from ._forecast import Forecast, expected_ahead, expected_from, starts_of
from ._gaussian import GaussianUpdate, symmetric
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._moving_horizon import MovingHorizonEstimator
from ._process_noise import ProcessNoise

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# The state of a rig at each sample, given all readings: those before it and those after it.
#
# This is the modified Bryson-Frazier smoother (G. J. Bierman, Factorization Methods for
# Discrete Sequential Estimation, 1977, chapter 10): a vector $\lambda$ and a matrix $\Lambda$
# go backwards through the linearised steps and corrections of the filter,
#
# $$\lambda \leftarrow (I - K H)^T \lambda - H^T w, \qquad
# \Lambda \leftarrow (I - K H)^T \Lambda (I - K H) + H^T H$$
#
# at the readings of a sample with whitened innovations $w$, where $H$ and the gain $K$ are
# those of the whitened readings (`_gaussian`); $\lambda \leftarrow F^T \lambda$ and $\Lambda
# \leftarrow F^T \Lambda F$ at each step. The state then is $x - P \lambda$ with the covariance
# $P - P \Lambda P$. No covariance is inverted, so that states without any noise, such as the
# lag of a driver, need no care.

Adjoint = tuple[Float[Array, " state"], Float[Array, "state state"]]


def smoothed(kalman: ExtendedKalmanFilter, states: KalmanState, samples: FilterSamples) -> Moments:
    """The moments of the state at each sample, given all readings.

    **Arguments:**

    - `states`: the filter's states after each sample.
    """
    rows = padded_rows(states, MIN_SAMPLES)
    return first_rows(_smoothed(kalman, rows, samples.padded()), len(samples.dt))


@persistent_jit
def _smoothed(kalman: ExtendedKalmanFilter, states: KalmanState, samples: FilterSamples) -> Moments:
    def take(
        later: Adjoint, at: tuple[KalmanState, KalmanState, FilterSamples]
    ) -> tuple[Adjoint, Moments]:
        before, after, sample = at
        vector, matrix = later
        mean = after.mean - after.covariance @ vector
        covariance = after.covariance - after.covariance @ matrix @ after.covariance
        result = moments(kalman.model, mean, covariance)
        predicted, step = kalman.linearised_step(before, sample.duty, sample.dt, sample.levels)
        correction = kalman.measurement_update(
            predicted, sample.readings, jnp.isfinite(sample.readings), sample.ambient
        )
        vector, matrix = _before_readings(later, correction)
        matrix = step.slope.T @ matrix @ step.slope
        return (step.slope.T @ vector, symmetric(matrix)), result

    # The first sample is corrected as well, but what is before it is of no interest.
    before = jax.tree.map(lambda leaf: jnp.concatenate([leaf[:1], leaf[:-1]]), states)
    size = states.mean.shape[1]
    none = jnp.zeros(size, states.mean.dtype), jnp.zeros((size, size), states.mean.dtype)
    _, result = jax.lax.scan(take, none, (before, states, samples), reverse=True)
    return result


def _before_readings(after: Adjoint, correction: GaussianUpdate) -> Adjoint:
    """The adjoint before the readings of a sample, given that after them."""
    vector, matrix = after
    gain, slope = correction.gain, correction.slope
    left = jnp.eye(len(vector)) - gain @ slope
    vector = left.T @ vector - slope.T @ correction.whitened
    return vector, left.T @ matrix @ left + slope.T @ slope


@final
@dataclass(frozen=True, eq=False, repr=False)
class Observed(AbstractResult):
    """A recording that `jaxtwin.observe` followed: what was expected of each reading, and what the
    readings say of the rig.

    **Arguments:**

    - `experiment`: the recording.
    - `observer`: the filter. It goes on, live, from `state`.
    - `samples`: its samples and further times in its gaps. `is_sample`: which of them are samples.
    - `filtered`: the states of the filter, and what it expected.
    - `estimator`: the moving-horizon estimator that found these states; None for the filter.
    """

    experiment: Experiment
    observer: ExtendedKalmanFilter
    samples: FilterSamples
    is_sample: Bool[np.ndarray, " times"]
    filtered: Filtered
    estimator: MovingHorizonEstimator | None = None

    @property
    def time(self) -> Float[np.ndarray, " samples"]:
        """The times of the samples, s."""
        return self.experiment.time

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the channels."""
        return self.experiment.channels

    @property
    def noise(self) -> ProcessNoise:
        """The levels of the noise that were assumed."""
        return self.observer.model.noise

    @property
    def state(self) -> KalmanState:
        """The state of the filter after the last sample."""
        return jax.tree.map(lambda leaf: leaf[-1], self.filtered.states)

    @cached_property
    def expected(self) -> Forecast:
        """What was expected of each reading at the sample before."""
        variance = np.diagonal(self._at_samples(self.filtered.covariance), axis1=1, axis2=2)
        mean = self._at_samples(self.filtered.expected)
        return self._forecast(math.nan, self.time, mean, np.sqrt(variance), self._recorded)

    @property
    def innovations(self) -> Float[np.ndarray, "samples channels"]:
        """Readings minus expected readings, K; NaN for missing readings."""
        return self.expected.residuals

    @property
    def innovation_covariance(self) -> Float[np.ndarray, "samples channels channels"]:
        """The covariance of the innovations, K^2."""
        return self._at_samples(self.filtered.covariance)

    @property
    def standardised(self) -> Float[np.ndarray, "samples channels"]:
        """The innovations, each less what those of the channels before it say of it and divided by
        its standard deviation: independent, with variance 1, if noise and twin are right. NaN for
        missing and rejected readings."""
        whitened = self._at_samples(self.filtered.states.whitened)
        return np.where(np.isfinite(self._recorded) & ~self.rejected, whitened, math.nan)

    @property
    def rejected(self) -> Bool[np.ndarray, "samples channels"]:
        """The readings that the filter rejected, because no noise is as large: lone ones, and the
        first of what lasts."""
        return self._at_samples(self.filtered.states.is_rejected)

    @cached_property
    def impossible(self) -> Bool[np.ndarray, "samples channels"]:
        """The rejected readings that were impossible: the next reading of their channel that was
        not rejected was as expected again. What lasts to the end of the recording is none."""
        rejected, read = self.rejected, np.isfinite(self._recorded)
        outside = self._at_samples(self.filtered.states.rejected) > 0
        impossible = np.zeros_like(rejected)
        for channel in np.flatnonzero(rejected.any(axis=0)):
            accepted = np.flatnonzero(read[:, channel] & ~rejected[:, channel])
            for sample in np.flatnonzero(rejected[:, channel]):
                later = accepted[np.searchsorted(accepted, sample) :]
                impossible[sample, channel] = len(later) > 0 and not outside[later[0], channel]
        return impossible

    @property
    def nis(self) -> Float[np.ndarray, " samples"]:
        """The normalised innovation squared of each sample, divided by the number of its readings:
        1 on average if noise and twin are right. NaN for a sample without readings."""
        count = np.isfinite(self.standardised).sum(axis=1)
        total = np.nansum(self.standardised**2, axis=1)
        return np.where(count > 0, total / np.maximum(count, 1), math.nan)

    @cached_property
    def log_likelihood(self) -> float:
        """The logarithm of the probability density of all readings."""
        return float(self._at_samples(self.filtered.states.log_likelihood).sum())

    @cached_property
    def estimates(self) -> Estimates:
        """The state of the rig at each sample, given the readings up to it."""
        with own_settings():
            result = moments_of(self.observer, self.filtered.states)
        return self._estimates("filtered", result)

    def smooth(self) -> Estimates:
        """Returns the state of the rig at each sample, given all readings.

        **Raises:** `ObserverError` for a recording that was followed within bounds, which a
        smoother does not know.
        """
        if self.estimator is not None:
            raise ObserverError(
                "smooth: expected a recording that was observed without bounds and horizon; a "
                "horizon as long as the recording takes in all readings"
            )
        with own_settings():
            result = smoothed(self.observer, self.filtered.states, self.samples)
        return self._estimates("smoothed", result)

    def ahead(self, seconds: float) -> Forecast:
        """Returns what was expected of each reading some seconds before it.

        The commands between are taken as known. Samples before the first forecast are left out.

        **Arguments:**

        - `seconds`: the time ahead, s.

        **Raises:** `ObserverError` if the recording is not longer than that.
        """
        lead = finite_number("ahead: seconds", seconds, ObserverError)
        if not 0 <= lead <= self.experiment.duration:
            raise ObserverError(
                f"ahead: seconds: expected 0 to {self.experiment.duration:g}, the duration of the "
                f"recording, got {lead:.10g}"
            )
        ends, counts = starts_of(self.samples, self.is_sample, lead)
        with own_settings():
            result = expected_ahead(self.observer, self.filtered.states, self.samples, ends, counts)
        place = np.cumsum(self.is_sample)[ends] - 1
        return self._forecast(
            lead, self.time[place], np.asarray(result.mean), np.asarray(result.spread),
            self._recorded[place],
        )  # fmt: skip

    def forecast(self, horizon: float, *, duty: object = None, at: float | None = None) -> Forecast:
        """Returns what is expected after a time, without any further reading.

        **Arguments:**

        - `horizon`: the length of the forecast, s. The rig's other inputs are those of the
          recording, and its last ones after its end.
        - `duty`: the duty cycles from then on: a number, or one for each cell, that is held; or an
          array `(times, cells)`, a row for each sample time; None: those of the recording, and its
          last ones after its end.
        - `at`: the time of the last reading that is known, s; None: the end of the recording.

        **Raises:** `ObserverError` if one of them is not valid.
        """
        length = finite_number("forecast: horizon", horizon, ObserverError)
        begin = self.time[-1] if at is None else finite_number("forecast: at", at, ObserverError)
        if not self.time[0] <= begin <= self.time[-1]:
            raise ObserverError(
                f"forecast: at: expected a time of the recording, {self.time[0]:.10g} to "
                f"{self.time[-1]:.10g} s, got {begin:.10g}"
            )
        step = float(np.median(np.diff(self.time)))
        count = round(length / step)
        if count < 1:
            raise ObserverError(
                f"forecast: horizon: expected at least the sample time of {step:.10g} s, got "
                f"{length:g}"
            )
        known = int(np.searchsorted(self.time, begin + 1e-9, side="right")) - 1
        times = self.time[known] + step * np.arange(1, count + 1)
        middle = times - step / 2
        commands = self._commands(duty, middle)
        place = int(np.flatnonzero(self.is_sample)[known])
        state = jax.tree.map(lambda leaf: leaf[place], self.filtered.states)
        with own_settings():
            levels = None
            if self._levels is not None:
                levels = self._levels[np.searchsorted(self.time, middle, side="right") - 1]
            samples = samples_between(commands, step, len(self.channels), self.observer, levels)
            result = expected_from(self.observer, state, samples)
        each = len(np.asarray(result.mean)) // count
        mean, spread = (np.asarray(part)[each - 1 :: each] for part in result)
        return self._forecast(math.nan, times, mean, spread, None)

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the filtered estimates as `Estimates.to_xarray`, with recorded and expected
        readings, the spread of the latter, standardised innovations (time, channel) and nis
        (time)."""
        data = self.estimates.to_xarray().assign_attrs(recording=self.experiment.name)
        dims, celsius = ("time", "channel"), {"units": "degC"}
        data["recorded"] = (dims, self._recorded, celsius)
        data["expected"] = (dims, self.expected.mean, celsius)
        data["expected_spread"] = (dims, self.expected.spread, {"units": "K"})
        data["standardised_innovation"] = (dims, self.standardised, {"units": "1"})
        data["nis"] = ("time", self.nis, {"units": "1"})
        return data

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each sample and channel: what was expected, as
        `Forecast.to_dataframe`, and the standardised innovation."""
        innovations = self.standardised.ravel()
        return self.expected.to_dataframe().assign(standardised_innovation=innovations)

    def plot(self) -> "Figure":
        """Draws readings and estimates over time with their bands.

        **Returns:** the figure.
        """
        return picture("plot_observed", self)

    def plot_innovations(self) -> "Figure":
        """Draws the tests of the innovations: their quantiles, autocorrelation and partial
        autocorrelation, and the error of forecasts over the time ahead.

        **Returns:** the figure.
        """
        return picture("plot_innovations", self)

    def __repr__(self) -> str:
        name = self.experiment.name or "a recording"
        return (
            f"<Observed {name}: {len(self.time)} samples, innovations of "
            f"{self.expected.rmse:.3f} K, normalised innovation squared {np.nanmean(self.nis):.2f}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        end = self.estimates
        named = {
            **{f"{node}, °C": end.node(node) for node in end.nodes},
            "room, °C": end.room,
            **{f"heat at {cell}, W": end.heat(cell) for cell in end.cells},
        }
        means = [band.mean[-1] for band in named.values()]
        reaches = [band.upper[-1] - band.mean[-1] for band in named.values()]
        return table({"estimate at the end": list(named), "value": means, "± 95 %": reaches})

    @property
    def _levels(self) -> Float[np.ndarray, "samples inputs"] | None:
        """The rig's other inputs from each sample on."""
        return input_levels(self.experiment, self.observer.model.twin.rig.inputs)

    @property
    def _recorded(self) -> Float[np.ndarray, "samples channels"]:
        assert self.experiment.temperatures is not None
        return self.experiment.temperatures

    def _at_samples(self, values: object) -> np.ndarray:
        return np.asarray(values)[self.is_sample]

    def _commands(
        self, duty: object, times: Float[np.ndarray, " times"]
    ) -> Float[np.ndarray, "times cells"]:
        """The duty cycles in force at some times."""
        recorded = np.asarray(self.experiment.duty, float)
        if duty is None:
            return recorded[np.searchsorted(self.time, times, side="right") - 1]
        shape = (len(times), recorded.shape[1])
        try:
            given = np.broadcast_to(np.asarray(duty, float), shape)
        except (TypeError, ValueError):
            given = None
        lowest = np.array(self.observer.model.twin.rig.lowest_duty)
        if given is None or not ((lowest <= given) & (given <= 1)).all():
            raise ObserverError(
                f"forecast: duty: expected numbers from {lowest.min():.10g} to 1, one for all, "
                f"{shape[1]} (one for each cell), or an array of shape {shape}, got {duty!r}"
            )
        return given

    def _forecast(
        self,
        lead: float,
        time: Float[np.ndarray, " times"],
        mean: Float[np.ndarray, "times channels"],
        spread: Float[np.ndarray, "times channels"],
        recorded: Float[np.ndarray, "times channels"] | None,
    ) -> Forecast:
        name = self.experiment.name
        return Forecast(name, lead, time, self.channels, mean, spread, recorded)

    def _estimates(self, kind: str, result: Moments) -> Estimates:
        model = self.observer.model
        at_samples = jax.tree.map(self._at_samples, result)
        return Estimates(
            kind=kind,
            time=self.time,
            nodes=tuple(node.name for node in model.twin.netlist.nodes),
            channels=self.channels,
            cells=model.twin.rig.driven,
            moments=at_samples,
            directions=model.directions,
        )
