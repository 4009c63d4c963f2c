"""Healthy recordings that the model of an observer makes: its twin, with all that the observer
takes as uncertain drawn at random."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..io import Experiment
from ..observers import ExtendedKalmanFilter, KalmanState, Observed
from ..observers._filter_run import FilterSamples, filtered
from ..observers._programs import started
from ..observers._start import first_reading

# The degrees of freedom of Student's distribution of the simulated noise of readings, whose
# kurtosis is infinite: that of real innovations is 5 to 100.
FREEDOM = 4.0

# The largest multiple of a standard deviation that is drawn: the filter is linear about its twin,
# and a rig that is farther away is not healthy.
MAX_DRAW_SIGMAS = 2.5

# The mean time between two corrections of a camera without an interval, s.
CORRECTIONS = 160.0


def simulated(observed: Observed, seed: int) -> Observed:
    """An observed recording of which rig and readings are drawn anew.

    The values of the twin, the start, the room and the heats are drawn from the filter's
    distribution at the start, and noise from that of each step; duty and times are those of the
    recording.
    """
    kalman, samples, old = observed.observer, observed.samples, observed.experiment
    with own_settings():
        first = np.asarray(first_reading(old))
        start = started(kalman, first, np.zeros_like(samples.duty[0]))
        drawn = np.asarray(_drawn(kalman, start, samples, jax.random.key(seed)))
        readings = np.where(np.isfinite(samples.readings), drawn, np.nan)
        samples = samples._replace(readings=readings)
        run = filtered(kalman, start, samples)
    experiment = Experiment(
        old.time,
        old.duty,
        channels=old.channels,
        temperatures=readings[np.asarray(observed.is_sample)],
        ambient=old.ambient,
        inputs=old.inputs,
        name=old.name,
        group=old.group,
    )
    return dataclasses.replace(observed, experiment=experiment, samples=samples, filtered=run)


@persistent_jit
def _drawn(
    kalman: ExtendedKalmanFilter, start: KalmanState, samples: FilterSamples, key: PRNGKeyArray
) -> Float[Array, "samples channels"]:
    """Draws a rig and its readings."""
    model = kalman.model
    of_start, of_phase, of_steps = jax.random.split(key, 3)
    size = len(start.mean)
    parts, interval = len(model.relaxation), model.interval
    values, room = model.layout.of("values"), model.layout.of("room").start

    def drawn(mean: Array, covariance: Array, one: PRNGKeyArray) -> Array:
        variances, vectors = jnp.linalg.eigh(covariance)
        roots = jnp.sqrt(jnp.maximum(variances, 0.0))
        return mean + vectors @ (
            roots * jax.random.truncated_normal(one, -MAX_DRAW_SIGMAS, MAX_DRAW_SIGMAS, (size,))
        )

    def take(
        carry: tuple[KalmanState, Array], given: tuple[FilterSamples, Array]
    ) -> tuple[tuple[KalmanState, Array], Array]:
        (state, since), (sample, one) = carry, given
        of_noise, of_time, of_jump, of_reading = jax.random.split(one, 4)
        after, transition = kalman.linearised_step(state, sample.duty, sample.dt, sample.levels)
        mean = drawn(after.mean, transition.noise, of_noise)
        if parts:
            since = since + sample.dt
            if interval is None:
                is_corrected = jax.random.uniform(of_time) < sample.dt / CORRECTIONS
            else:
                is_corrected = since >= interval
                since = jnp.where(is_corrected, since - interval, since)
            jump = model.noise.jump_mean + model.noise.jump * jax.random.normal(of_jump, (parts,))
            mean = mean.at[model.layout.fading].add(jnp.where(is_corrected, jump, 0.0))
        # The values differ between rigs, and do not wander within one.
        mean = mean.at[values].set(state.mean[values])
        # A room that is measured is that of the recording.
        measured = model.from_degC(jnp.asarray(sample.ambient))
        mean = mean.at[room].set(jnp.where(jnp.isfinite(measured), measured, mean[room]))
        # A single rig is drawn: its covariance is of no use.
        after = eqx.tree_at(lambda s: (s.mean, s.covariance), after, (mean, state.covariance))
        heavy = jax.random.t(of_reading, FREEDOM, (len(model.columns),))
        error = heavy * jnp.sqrt((1 - 2 / FREEDOM) * kalman.reading_variance(after))
        return (after, since), kalman.readings(after, sample.ambient) + error

    # The filter does not know when the camera corrected itself last.
    since = (interval or 0.0) * jax.random.uniform(of_phase)
    begin = eqx.tree_at(lambda s: s.mean, start, drawn(start.mean, start.covariance, of_start))
    keys = jax.random.split(of_steps, len(samples.dt))
    return jax.lax.scan(take, (begin, since), (samples, keys))[1]
