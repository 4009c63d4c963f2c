r"""Filters of the faults that may explain a recording, side by side.

Each is the observer with one more state, the multiple $m$ of its fault (`_signatures`), which
begins with its prior at the onset. Steps and readings are linearised at the state that the filter
itself has, so that a fault may be as large as it likes. Its likelihood is that of the fault with
any size.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._compilation import persistent_jit
from ..observers import (
    Commands,
    ExpectedReading,
    ExtendedKalmanFilter,
    FilterSamples,
    Gaussian,
    KalmanState,
    expected_jump,
    measurement_update,
    symmetric,
)
from ._signatures import Suspected, is_held, of_readings, of_step


class Hypotheses(NamedTuple):
    """Faults with what is known of them beforehand; or a single one, with numbers in place of
    arrays.

    - `onset`: the number of the first sample. `held`: the readings then, K.
    - `spread`: the standard deviation of the multiple; `least`, `largest`: its bounds.
    """

    faults: Suspected
    onset: Int[np.ndarray | Array, "*faults"]
    held: Float[np.ndarray | Array, "*faults channels"]
    spread: Float[np.ndarray | Array, "*faults"]
    least: Float[np.ndarray | Array, "*faults"]
    largest: Float[np.ndarray | Array, "*faults"]


class Tracked(NamedTuple):
    """What the filter of a hypothesis says after each sample.

    - `log_likelihood`: of the readings since the onset.
    - `misfit`: the mean square of the whitened innovations since the onset, 1 if the fault explains
      them.
    - `multiple`, `spread`: of the fault, and the standard deviation.
    """

    log_likelihood: Float[Array, " samples"]
    misfit: Float[Array, " samples"]
    multiple: Float[Array, " samples"]
    spread: Float[Array, " samples"]


class _State(NamedTuple):
    """The state of such a filter: mean and covariance have the multiple as their last entry. The
    last three are sums since the onset: of the logarithms of the densities of the readings, of the
    squares of their whitened innovations, and the number of readings."""

    known: Gaussian
    duty: Float[Array, " cells"]
    commands: Commands
    slope: Float[Array, " channels"]
    since_correction: Float[Array, ""]
    log_likelihood: Float[Array, ""]
    squares: Float[Array, ""]
    readings: Float[Array, ""]


def follow(
    kalman: ExtendedKalmanFilter,
    hypothesis: Hypotheses,
    numbers: Int[Array, " samples"],
    befores: KalmanState,
    samples: FilterSamples,
) -> Tracked:
    """Follows samples under a single hypothesis.

    **Arguments:**

    - `numbers`: the numbers of the samples. `befores`: the states of the healthy filter before
      each of them.
    """
    one = hypothesis.faults

    def take(state: _State, at: tuple[Array, KalmanState, FilterSamples]) -> tuple[_State, Tracked]:
        number, before, sample = at
        begins = number == hypothesis.onset
        fresh = _begun(before, hypothesis)
        state = jax.tree.map(lambda new, old: jnp.where(begins, new, old), fresh, state)
        state = _stepped(kalman, one, state, sample)
        state = _corrected(kalman, one, hypothesis, state, sample, number >= hypothesis.onset)
        return state, Tracked(
            log_likelihood=state.log_likelihood,
            misfit=state.squares / jnp.maximum(state.readings, 1.0),
            multiple=state.known.mean[-1],
            spread=jnp.sqrt(state.known.covariance[-1, -1]),
        )

    first = jax.tree.map(lambda leaf: leaf[0], befores)
    return jax.lax.scan(take, _begun(first, hypothesis), (numbers, befores, samples))[1]


@persistent_jit
def tracked(
    kalman: ExtendedKalmanFilter,
    hypotheses: Hypotheses,
    numbers: Int[Array | np.ndarray, " samples"],
    befores: KalmanState,
    samples: FilterSamples,
) -> Tracked:
    """Follows samples under several hypotheses at once."""
    faults, *others = hypotheses
    of_healthy, of_faulty = (None, None) if faults.changes is None else faults.changes
    stacked = faults.faulty, of_faulty, faults.held, faults.drift

    def each(stacked: tuple, others: list) -> Tracked:
        faulty, change, held, drift = jax.tree.map(lambda x: jnp.asarray(x)[None], stacked)
        changes = None if of_healthy is None else (of_healthy, change)
        one = Suspected(faults.healthy, faulty, changes, held, drift)
        return follow(kalman, Hypotheses(one, *others), jnp.asarray(numbers), befores, samples)

    return jax.vmap(each)(stacked, others)


def _begun(before: KalmanState, hypothesis: Hypotheses) -> _State:
    """The state at the onset."""
    size = len(before.mean)
    covariance = jnp.zeros((size + 1, size + 1), before.mean.dtype)
    covariance = covariance.at[:size, :size].set(before.covariance)
    covariance = covariance.at[size, size].set(jnp.asarray(hypothesis.spread) ** 2)
    return _State(
        Gaussian(jnp.append(before.mean, 0.0), covariance), before.duty, before.commands,
        before.slope, before.since_correction, *jnp.zeros(3, before.mean.dtype),
    )  # fmt: skip


def _stepped(
    kalman: ExtendedKalmanFilter,
    one: Suspected,
    state: _State,
    sample: FilterSamples,
) -> _State:
    model = kalman.model
    mean, size = state.known.mean[:-1], len(state.known.mean) - 1
    dt = jnp.asarray(sample.dt, mean.dtype)
    commands = state.commands.given(jnp.asarray(sample.duty, mean.dtype), kalman.spacing)
    transition, duty = model.step(mean, state.duty, commands, dt, sample.levels)
    block = model.layout.of("modes")

    def added(z: Array) -> Array:
        at = mean.at[block].set(z)
        return of_step(model, one, at, state.duty, commands, dt, sample.levels)[:, 0]

    multiple = state.known.mean[-1]
    effect, by_modes = added(mean[block]), jax.jacfwd(added)(mean[block])
    slope = jnp.zeros((size + 1, size + 1), mean.dtype)
    slope = slope.at[:size, :size].set(transition.slope).at[size, size].set(1.0)
    slope = slope.at[:size, block].add(multiple * by_modes)
    slope = slope.at[:size, size].set(effect)
    covariance = slope @ state.known.covariance @ slope.T
    jump = expected_jump(model, state.since_correction, dt)
    noise = transition.noise + jnp.diag(jump.variance)
    covariance = covariance.at[:size, :size].add(noise)
    after = transition.mean + jump.mean + multiple * effect
    return state._replace(
        known=Gaussian(jnp.append(after, state.known.mean[-1]), symmetric(covariance)),
        duty=duty,
        commands=commands.older(dt),
        slope=model.slope_of_readings(mean, after, dt, state.slope),
        since_correction=state.since_correction + dt,
    )


def _corrected(
    kalman: ExtendedKalmanFilter,
    one: Suspected,
    hypothesis: Hypotheses,
    state: _State,
    sample: FilterSamples,
    counts: Bool[Array, ""],
) -> _State:
    """The state after readings; those before the onset do not count."""
    model, noise = kalman.model, kalman.model.noise
    layout = model.layout
    mean, size = state.known.mean[:-1], len(state.known.mean) - 1
    measured = model.from_degC(jnp.asarray(sample.readings, mean.dtype))
    used = jnp.isfinite(measured)
    healthy = model.read(mean)
    block = layout.of("modes")

    def added(z: Array) -> Array:
        return of_readings(model, one, mean.at[block].set(z))[:, 0]

    multiple = state.known.mean[-1]
    held = is_held(one, len(used))[:, 0]
    effect = added(mean[block]) + held * (hypothesis.held - healthy.mean)
    slope = jnp.zeros((len(used), size + 1), mean.dtype)
    slope = slope.at[:, :size].set((1 - multiple * held)[:, None] * healthy.slope)
    slope = slope.at[:, block].add(multiple * jax.jacfwd(added)(mean[block]))
    slope = slope.at[:, size].set(effect)
    expected = ExpectedReading(healthy.mean + multiple * effect, slope)
    variance = jnp.asarray(noise.reading) ** 2 + (noise.reading_time * state.slope) ** 2
    innovation = measured - expected.mean
    added_variance, of_camera = kalman.added_variance(
        state.known, expected, innovation, variance, used
    )
    place = layout.of("room").start
    room = model.from_degC(jnp.asarray(sample.ambient, mean.dtype)) - mean[place]
    of_room = jnp.zeros(size + 1, mean.dtype).at[place].set(1.0)
    result = measurement_update(
        Gaussian(state.known.mean, state.known.covariance + jnp.diag(added_variance)),
        jnp.concatenate([room[None], innovation]),
        jnp.concatenate([of_room[None], slope]),
        jnp.concatenate([jnp.reshape(noise.ambient**2, 1), variance]),
        jnp.concatenate([jnp.isfinite(room)[None], used]),
        layout.of("values"),
    )
    duty = result.state.mean[layout.of("duty")] if layout.duty else state.duty
    limited = jnp.clip(result.state.mean[-1], hypothesis.least, hypothesis.largest)
    return state._replace(
        known=Gaussian(result.state.mean.at[-1].set(limited), result.state.covariance),
        duty=duty,
        since_correction=jnp.where(of_camera, 0.0, state.since_correction),
        log_likelihood=state.log_likelihood + counts * result.log_densities[1:].sum(),
        squares=state.squares + counts * (result.whitened[1:] ** 2).sum(),
        readings=state.readings + counts * used.sum(),
    )
