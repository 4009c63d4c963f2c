r"""Forecasts of the readings from states of a filter.

The mean of a forecast is a simulation of its own. Its covariance is that of the linearised steps:
with $v = \partial y_k / \partial x_k$, the variance of a reading $y_k$ that is expected from the
state $m$ samples before is

$$\sum_{j=k-m+1}^{k} v_j Q_j v_j^T + v_{k-m} P_{k-m} v_{k-m}^T + r_k, \qquad v_{j-1} = v_j F_j,$$

so that only the rows $v$ of the channels are carried, not covariances. The steps $F_j$ are those
along the filtered states, the same for all forecasts. A correction of the camera that is expected
on the way (`_expected_correction`) adds its variance, which fades: a forecast expects it from what
was known at its start.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._jax_settings import own_settings
from ._augmented_model import Transition
from ._filter_run import FilterSamples, samples_between
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._moments import Moment

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
    steps = int(counts.max())
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
    """The samples of which something was expected so many seconds before, and the number of steps
    from the last state that was known then."""
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
    return -(-(int(max(spans)) + steps + 1) // 64) * 64


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
    taken = jax.lax.map(transition, (earlier, later), batch_size=16)
    return expected_at(kalman, states, samples, taken, ends, counts, steps)


def expected_at(
    kalman: ExtendedKalmanFilter,
    states: KalmanState,
    samples: FilterSamples,
    taken: Transition,
    ends: Int[Array | np.ndarray, " forecasts"],
    counts: Int[Array | np.ndarray, " forecasts"],
    steps: int,
) -> Moment:
    """What was expected of the readings of some samples, as a function that can be differentiated.

    **Arguments:** as for `expected_ahead`; `steps` is the largest number of steps. `taken` are the
    filter's steps, that from sample k to sample k + 1 in row k.
    """
    model = kalman.model
    driven = taken.driven.shape[-1]
    following = jax.tree.map(lambda leaf: leaf[1:], samples)

    def forecast(end: Array, count: Array) -> tuple[KalmanState, Float[Array, " state"]]:
        @jax.checkpoint
        def take(
            carry: tuple[KalmanState, Array], number: Array
        ) -> tuple[tuple[KalmanState, Array], None]:
            state, of_jumps = carry
            row = jnp.minimum(end - count + number, len(taken.decay) - 1)
            sample = jax.tree.map(lambda leaf: leaf[row], following)
            after = kalman.step_of_mean(state, sample.duty, sample.dt, sample.levels)
            jump = kalman.expected_jump(state, sample.dt)
            later = after, of_jumps * model.decay(sample.dt) ** 2 + jump.variance
            return jax.tree.map(partial(jnp.where, number < count), later, carry), None

        start = jax.tree.map(lambda leaf: leaf[end - count], states)
        none = jnp.zeros_like(start.mean)
        return jax.lax.scan(take, (start, none), jnp.arange(steps))[0]

    result, of_jumps = jax.vmap(forecast)(jnp.asarray(ends), jnp.asarray(counts))
    seen = jax.vmap(model.read)(result.mean)

    @jax.checkpoint
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


@persistent_jit_unoptimised
def expected_from(
    kalman: ExtendedKalmanFilter, state: KalmanState, samples: FilterSamples
) -> Moment:
    """The readings that a state lets expect at further times, without any reading between."""

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
