r"""A filter whose equations are linearised once, along the states of a run.

Levels of noise change how far a filter follows its readings, by tenths of a kelvin; what the
equations of the rig do to such a change is all but linear. With the state before a step and the
expected readings written as deviations from those of the run, a pass with other levels needs no
simulation: it is a product with the matrices of the run. The factors of decay and the covariance
of the process noise are computed for the levels.

The forecast of a reading from the state $m$ samples before differs from the one that the filter had
one sample before by what the updates $\delta_j$ between have told it:

$$\hat y_{k|k-m} = \hat y_{k|k-1} - \sum_{j=k-m+1}^{k-1} v_j \delta_j , \qquad
v_{j-1} = v_j F_j, \quad v_k = H_k ,$$

so that the rows $v$ that its variance needs (`_forecast`) give its mean too.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compilation import persistent_jit_unoptimised
from ._augmented_model import Evolution, ExpectedReading
from ._estimates import Moment
from ._expected_correction import expected_jump
from ._filter_run import FilterSamples
from ._kalman_filter import ExtendedKalmanFilter, KalmanState


class LinearisedPath(NamedTuple):
    """The steps of a run and the readings after them, linearised. The first axis of each leaf is
    that of the samples.

    - `dt`: the length of the step to each sample, s; 0 for one that is no step.
    - `before`: the mean before the step. `evolution`: what the step does to it.
    - `after`: the mean after the step, before the readings. `expected`: the readings there.
    - `rate`: the expected change of the readings in the step, K/s.
    - `readings`, `ambient`: what was measured, degC; NaN where nothing was.
    """

    dt: Float[Array, " samples"]
    before: Float[Array, "samples state"]
    evolution: Evolution
    after: Float[Array, "samples state"]
    expected: ExpectedReading
    rate: Float[Array, "samples channels"]
    readings: Float[Array, "samples channels"]
    ambient: Float[Array, " samples"]


class LinearRun(NamedTuple):
    """The states of a linear filter after each sample.

    - `states`: the states.
    - `expected`: the readings that were expected, K above the reference.
    - `update`: by how much the readings changed the mean.
    - `since_correction`: the time since the last correction of the camera before each step, s.
    """

    states: KalmanState
    expected: Float[Array, "samples channels"]
    update: Float[Array, "samples state"]
    since_correction: Float[Array, " samples"]


@persistent_jit_unoptimised
def linearised_path(
    kalman: ExtendedKalmanFilter, before: KalmanState, samples: FilterSamples
) -> LinearisedPath:
    """Linearises the steps to some samples and their readings.

    **Arguments:**

    - `before`: the filter's states before the steps.
    - `samples`: the samples.
    """
    model = kalman.model

    def of(row: tuple[KalmanState, FilterSamples]) -> LinearisedPath:
        state, sample = row
        commands, dt = kalman.commands(state, sample.duty, sample.dt)
        evolution, _ = model.evolution(state.mean, state.duty, commands, dt, sample.levels)
        after = model.transition(evolution, state.mean, dt).mean
        after = after + kalman.expected_jump(state, dt).mean
        rate = model.slope_of_readings(state.mean, after, dt, state.slope)
        return LinearisedPath(
            dt,
            state.mean,
            evolution,
            after,
            model.read(after),
            rate,
            jnp.asarray(sample.readings),
            jnp.asarray(sample.ambient),
        )

    return jax.lax.map(of, (before, samples), batch_size=16)


def filter_path(
    kalman: ExtendedKalmanFilter, path: LinearisedPath, start: KalmanState
) -> LinearRun:
    """Filters a run again, with the filter's own levels of noise, as a function that can be
    differentiated."""
    model = kalman.model

    @jax.checkpoint
    def take(state: KalmanState, row: LinearisedPath) -> tuple[KalmanState, LinearRun]:
        driven = (state.mean - row.before)[: model.layout.driven]
        evolution = row.evolution._replace(end=row.evolution.end + row.evolution.slope @ driven)
        after = kalman.predicted(state, model.transition(evolution, state.mean, row.dt), row.dt)
        since = state.since_correction
        predicted = replace(
            state,
            mean=after.mean,
            covariance=after.covariance,
            since_correction=since + row.dt,
            slope=row.rate,
        )
        expected = row.expected.mean + row.expected.slope @ (after.mean - row.after)
        updated = kalman.update(
            predicted,
            row.readings,
            jnp.isfinite(row.readings),
            row.ambient,
            ExpectedReading(expected, row.expected.slope),
        )
        return updated, LinearRun(updated, expected, updated.mean - after.mean, since)

    return jax.lax.scan(take, start, path)[1]


def forecasts_of_path(
    kalman: ExtendedKalmanFilter,
    path: LinearisedPath,
    run: LinearRun,
    ends: Int[Array | np.ndarray, " forecasts"],
    counts: Int[Array | np.ndarray, " forecasts"],
    steps: int,
) -> Moment:
    """What was expected of the readings of some samples, K above the reference.

    **Arguments:**

    - `ends`: the numbers of the samples.
    - `counts`: how many samples before them each was expected, at most `steps`.
    """
    model = kalman.model
    dynamic, driven = model.layout.dynamic, model.layout.driven
    decay, walks = jax.vmap(model.decay)(path.dt), jax.vmap(model.walks)(path.dt)
    roots = jax.vmap(model.noise_roots)(path.evolution)
    modes = model.layout.of("modes")
    ends, counts = jnp.asarray(ends), jnp.asarray(counts)

    @jax.checkpoint
    def back(
        carry: tuple[Array, Array, Array], number: Array
    ) -> tuple[tuple[Array, Array, Array], None]:
        rows, mean, variance = carry
        step = jnp.maximum(ends - number, 0)
        heated = jnp.einsum("kcm,ksm->kcs", rows[..., modes], roots[step])
        added = (heated**2).sum(axis=-1) + jnp.einsum("kcs,ks->kc", rows**2, walks[step])
        by_first = rows[..., :dynamic] @ path.evolution.slope[step]
        by_others = rows * decay[step][:, None]  # the decay of what evolves is 0
        before = by_others.at[..., :driven].add(by_first)
        is_step, is_last = number < counts, number + 1 == counts
        variance = variance + jnp.where(is_step[:, None], added, 0.0)
        told = jnp.einsum("kcs,ks->kc", before, run.update[step - 1])
        mean = mean - jnp.where((is_step & ~is_last)[:, None], told, 0.0)
        return (jnp.where(is_step[:, None, None], before, rows), mean, variance), None

    noise = model.noise
    of_readings = noise.reading**2 + (noise.reading_time * path.rate[ends]) ** 2
    begin = path.expected.slope[ends], run.expected[ends], of_readings
    (rows, mean, variance), _ = jax.lax.scan(back, begin, jnp.arange(steps))
    covariance = run.states.covariance[ends - counts]
    variance = variance + jnp.einsum("kcs,kst,kct->kc", rows, covariance, rows)
    if model.interval is not None:
        of_mean, of_variance = _jumps(kalman, path, run, ends, counts, steps)
        mean, variance = mean + of_mean[:, None], variance + of_variance[:, None]
    return Moment(mean, jnp.sqrt(variance))


def _jumps(
    kalman: ExtendedKalmanFilter,
    path: LinearisedPath,
    run: LinearRun,
    ends: Int[Array, " forecasts"],
    counts: Int[Array, " forecasts"],
    steps: int,
) -> tuple[Float[Array, " forecasts"], Float[Array, " forecasts"]]:
    """What the corrections of a camera that are expected within the forecasts add to the mean, less
    what the filter expected on the way, and to the variance.

    A forecast expects them from the last one before its start, the filter from the last one that it
    saw."""
    model = kalman.model
    fading = model.layout.fading
    decay = jax.vmap(model.decay)(path.dt)[:, fading]

    def forecast(end: Array, count: Array) -> tuple[Array, Array]:
        def take(
            carry: tuple[Array, Array, Array], number: Array
        ) -> tuple[tuple[Array, Array, Array], None]:
            since, mean, variance = carry
            row = jnp.minimum(end - count + 1 + number, end)
            dt, kept = path.dt[row], decay[row]
            own = expected_jump(model, since, dt)
            seen = expected_jump(model, run.since_correction[row], dt)
            later = (
                since + dt,
                mean * kept + (own.mean - seen.mean)[fading],
                variance * kept**2 + own.variance[fading],
            )
            return jax.tree.map(
                lambda new, old: jnp.where(number < count, new, old), later, carry
            ), None

        none = jnp.zeros(fading.stop - fading.start, path.dt.dtype)
        since = run.states.since_correction[end - count]
        _, mean, variance = jax.lax.scan(take, (since, none, none), jnp.arange(steps))[0]
        return mean.sum(), variance.sum()

    return jax.vmap(forecast)(ends, counts)
