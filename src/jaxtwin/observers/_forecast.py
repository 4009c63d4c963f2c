"""What was expected of readings, with bands."""

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._display import picture
from .._jax_settings import own_settings
from .._padded_rows import first_rows, padded_count
from .._result import AbstractResult, dataset, table
from .._statistics import QUANTILE_975
from ._augmented_model import Transition
from ._estimates import Moment
from ._filter_run import FilterSamples, samples_between
from ._kalman_filter import ExtendedKalmanFilter, KalmanState

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# Forecasts of the readings from states of a filter.
#
# The mean of a forecast is a simulation of its own. Its covariance is that of the linearised
# steps: with $v = \partial y_k / \partial x_k$, the variance of a reading $y_k$ that is
# expected from the state $m$ samples before is
#
# $$\sum_{j=k-m+1}^{k} v_j Q_j v_j^T + v_{k-m} P_{k-m} v_{k-m}^T + r_k, \qquad v_{j-1} = v_j F_j,$$
#
# so that only the rows $v$ of the channels are carried, not covariances. The steps $F_j$ are
# those along the filtered states, the same for all forecasts. A correction of the camera that
# is expected on the way (`_expected_correction`) adds its variance, which fades: a forecast
# expects it from what was known at its start.

# The error of a sum of times, s.
TIME_TOLERANCE_SECONDS = 1e-6

# The number of forecasts of a block. All blocks share a compiled program.
FORECAST_BLOCK = 256


def expected_ahead(
    kalman: ExtendedKalmanFilter,
    states: KalmanState,
    samples: FilterSamples,
    ends: Int[np.ndarray, " forecasts"],
    counts: Int[np.ndarray, " forecasts"],
) -> Moment:
    """What was expected of the readings of some samples.

    **Arguments:**

    - `states`: the filter's states after each sample.
    - `ends`: the numbers of the samples, ascending.
    - `counts`: the number of steps of each forecast.
    """
    steps = padded_count(int(counts.max()))
    blocks = []
    for first in range(0, len(ends), FORECAST_BLOCK):
        of_block = np.minimum(np.arange(first, first + FORECAST_BLOCK), len(ends) - 1)
        last, count = ends[of_block], counts[of_block]
        # The samples of the block and those before it, the same number for all blocks.
        start = max(0, int((last - count).min()))
        rows = np.minimum(start + np.arange(_rows(ends, steps)), len(samples.dt) - 1)
        own_states = jax.tree.map(lambda leaf, r=rows: np.asarray(leaf)[r], states)
        own_samples = jax.tree.map(lambda leaf, r=rows: np.asarray(leaf)[r], samples)
        blocks.append(_block(kalman, own_states, own_samples, last - start, count, steps=steps))
    mean, spread = (
        np.concatenate([np.asarray(block[part]) for block in blocks])[: len(ends)]
        for part in (0, 1)
    )
    return Moment(mean, spread)


def starts_of(
    samples: FilterSamples, is_sample: Bool[np.ndarray, " samples"], seconds: float
) -> tuple[Int[np.ndarray, " forecasts"], Int[np.ndarray, " forecasts"]]:
    """The samples that were forecast at the given time before them, and the number of steps from
    the last state that was known then."""
    time = np.cumsum(samples.dt)
    start = np.searchsorted(time, time - seconds + TIME_TOLERANCE_SECONDS, side="right") - 1
    ends = np.flatnonzero((start >= 0) & is_sample)
    return ends, ends - start[ends]


def _rows(ends: Int[np.ndarray, " forecasts"], steps: int) -> int:
    """The largest number of samples between the first start and the last end of a block, rounded up
    so that recordings share compiled programs."""
    spans = [
        ends[min(first + FORECAST_BLOCK, len(ends)) - 1] - ends[first]
        for first in range(0, len(ends), FORECAST_BLOCK)
    ]
    return padded_count(int(max(spans)) + steps + 1, 64)


@persistent_jit
def _block(
    kalman: ExtendedKalmanFilter,
    states: KalmanState,
    samples: FilterSamples,
    ends: Int[Array | np.ndarray, " forecasts"],
    counts: Int[Array | np.ndarray, " forecasts"],
    steps: int,
) -> Moment:
    def transition(row: tuple[KalmanState, FilterSamples]) -> Transition:
        state, sample = row
        return kalman.linearised_step(state, sample.duty, sample.dt, sample.levels)[1]

    earlier = jax.tree.map(lambda leaf: leaf[:-1], states)
    later = jax.tree.map(lambda leaf: leaf[1:], samples)
    # The filter's steps, that from sample k to sample k + 1 in row k.
    taken = jax.lax.map(transition, (earlier, later), batch_size=16)
    model = kalman.model
    driven = taken.driven.shape[-1]
    following = jax.tree.map(lambda leaf: leaf[1:], samples)

    def forecast(end: Array, count: Array) -> tuple[KalmanState, Float[Array, " state"]]:
        def take(
            carry: tuple[KalmanState, Array], number: Array
        ) -> tuple[tuple[KalmanState, Array], None]:
            state, of_jumps = carry
            row = jnp.minimum(end - count + number, len(taken.decay) - 1)
            sample = jax.tree.map(lambda leaf: leaf[row], following)
            after = kalman.predict_mean(state, sample.duty, sample.dt, sample.levels)
            jump = kalman.expected_jump(state, sample.dt)
            later = after, of_jumps * model.decay(sample.dt) ** 2 + jump.variance
            return jax.tree.map(partial(jnp.where, number < count), later, carry), None

        start = jax.tree.map(lambda leaf: leaf[end - count], states)
        none = jnp.zeros_like(start.mean)
        return jax.lax.scan(take, (start, none), jnp.arange(steps))[0]

    result, of_jumps = jax.vmap(forecast)(jnp.asarray(ends), jnp.asarray(counts))
    seen = jax.vmap(model.read)(result.mean)

    def back(carry: tuple[Array, Array], number: Array) -> tuple[tuple[Array, Array], None]:
        rows, variance = carry
        step = jnp.maximum(ends - number - 1, 0)
        added = jnp.einsum("kcs,kst,kct->kc", rows, taken.noise[step], rows)
        is_step = number < counts
        variance = variance + jnp.where(is_step[:, None], added, 0.0)
        of_driven = rows[..., :driven] @ taken.driven[step]
        of_others = rows[..., driven:] * taken.decay[step][:, None]
        before = jnp.concatenate([of_driven, of_others], axis=-1)
        rows = jnp.where(is_step[:, None, None], before, rows)
        return (rows, variance), None

    of_readings = jax.vmap(kalman.reading_variance)(result)
    # Its parts are shared by all channels, and independent.
    begin = seen.slope, of_readings + of_jumps.sum(axis=-1, keepdims=True)
    (rows, variance), _ = jax.lax.scan(back, begin, jnp.arange(steps))
    # The covariance was left as it was at the start of the forecast.
    variance = variance + jnp.einsum("kcs,kst,kct->kc", rows, result.covariance, rows)
    return Moment(model.to_degC(seen.mean), jnp.sqrt(variance))


def expected_from(
    kalman: ExtendedKalmanFilter, state: KalmanState, samples: FilterSamples
) -> Moment:
    """The readings that a state lets expect at further times, without any reading between."""
    return first_rows(_expected_from(kalman, state, samples.padded()), len(samples.dt))


@persistent_jit_unoptimised
def _expected_from(
    kalman: ExtendedKalmanFilter, state: KalmanState, samples: FilterSamples
) -> Moment:
    def take(state: KalmanState, sample: FilterSamples) -> tuple[KalmanState, Moment]:
        state = kalman.step(state, sample.duty, sample.dt, sample.levels)
        variance = jnp.diag(kalman.reading_covariance(state))
        return state, Moment(kalman.readings(state, sample.ambient), jnp.sqrt(variance))

    return jax.lax.scan(take, state, samples)[1]


def forecast_from(
    kalman: ExtendedKalmanFilter,
    state: KalmanState,
    duty: Float[np.ndarray, " cells"],
    seconds: float,
) -> Moment:
    """What a state lets expect of the readings some time later, with the duty held and the rig's
    other inputs at those of the rig file."""
    with own_settings():
        held = np.asarray(duty, float)[None]
        samples = samples_between(held, seconds, len(kalman.model.columns), kalman)
        result = expected_from(kalman, state, samples)
    return Moment(np.asarray(result.mean)[-1], np.asarray(result.spread)[-1])


@final
@dataclass(frozen=True, repr=False, eq=False)
class Forecast(AbstractResult):
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
        readings = "time channel"
        variables = {
            "mean": (readings, self.mean, "degC"),
            "lower": (readings, self.lower, "degC"),
            "upper": (readings, self.upper, "degC"),
            "spread": (readings, self.spread, "K"),
            "time": ("time", self.time, "s"),
        }
        if self.recorded is not None:
            variables["recorded"] = (readings, self.recorded, "degC")
        attributes = {"recording": self.name, "lead_s": self.lead}
        return dataset(variables, attributes, channel=self.channels)

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

    def _overview(self) -> "pandas.DataFrame":
        there = np.isfinite(self.residuals)
        # NaN for a channel that was never read.
        counts = np.where(there.any(axis=0), there.sum(axis=0), math.nan)
        squares = np.where(there, self.residuals, 0.0) ** 2
        return table(
            {
                "channel": self.channels,
                "RMSE, K": np.sqrt(squares.sum(axis=0) / counts),
                "inside, %": 100 * self._inside.sum(axis=0) / counts,
                "band, K": 2 * QUANTILE_975 * self.spread.mean(axis=0),
            }
        )
