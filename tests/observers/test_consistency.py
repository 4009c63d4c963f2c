"""The filter is as uncertain as it is wrong: two hundred rigs are drawn from its own model, so that
their states are known (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 5.4)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from jaxtwin import Twin
from jaxtwin.observers import ExtendedKalmanFilter, KalmanState, ProcessNoise, live_observer

pytestmark = pytest.mark.usefixtures("float64")

RUNS, SAMPLES = 200, 60

# Directions with a smaller part of the variance are certain, up to rounding.
RANK = 1e-9

NOISE = ProcessNoise(
    reading=0.1, reading_time=0.1, heat=0.3, command_time=0.3, disturbance=0.3, room=0.01,
    common=0.2, channel=0.1, names=("R_E",),
)  # fmt: skip


def drawn(covariance: jax.Array, key: jax.Array) -> jax.Array:
    """A sample of a normal distribution whose covariance may be singular."""
    values, vectors = jnp.linalg.eigh(covariance)
    noise = jax.random.normal(key, values.shape, values.dtype)
    return vectors @ (jnp.sqrt(jnp.maximum(values, 0.0)) * noise)


def normalised(covariance: jax.Array, error: jax.Array) -> jax.Array:
    """The squared distance of an error in its own covariance, for the directions that have any."""
    scale = jnp.sqrt(jnp.maximum(jnp.diagonal(covariance), 1e-30))
    values, vectors = jnp.linalg.eigh(covariance / jnp.outer(scale, scale))
    along = vectors.T @ (error / scale)
    return jnp.where(values > RANK, along**2 / jnp.where(values > RANK, values, 1.0), 0.0).sum()


def run(kalman: ExtendedKalmanFilter, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Draws a rig and follows it: the squared distances, at each sample, of the innovations and of
    the error of the state in their covariances."""
    commands = jnp.asarray(np.repeat(np.random.default_rng(0).uniform(0, 1, (6, 1)), 10, axis=0))
    start = kalman.init(25.0, np.zeros(1))
    keys = jax.random.split(key, 2 * SAMPLES + 1)
    truth = replace(start, mean=start.mean + drawn(start.covariance, keys[-1]))

    def take(
        states: tuple[KalmanState, KalmanState], given: tuple[jax.Array, ...]
    ) -> tuple[tuple[KalmanState, KalmanState], tuple[jax.Array, ...]]:
        (truth, state), (command, of_step, of_reading) = states, given
        truth, step = kalman.linearised_step(truth, command, 1.0)
        truth = replace(truth, mean=truth.mean + drawn(step.noise, of_step))
        state = kalman.step(state, command, 1.0)
        # The noise that the filter assumes grows with the slope that it expects.
        spread = jnp.sqrt(kalman.reading_variance(state))
        readings = kalman.readings(truth, jnp.nan)
        readings = readings + spread * jax.random.normal(of_reading, spread.shape)
        state = kalman.update(state, readings, jnp.isfinite(readings), jnp.nan)
        error = truth.mean - state.mean
        distances = jnp.sum(state.whitened**2), normalised(state.covariance, error)
        return (truth, state), distances

    given = commands, keys[:SAMPLES], keys[SAMPLES:-1]
    nis, nees = jax.lax.scan(take, (truth, start), given)[1]
    return nis, nees


@pytest.mark.slow
def test_innovations_and_errors_of_two_hundred_rigs_are_in_their_bands():
    kalman = live_observer(Twin("single-cell"), NOISE)
    keys = jax.random.split(jax.random.key(0), RUNS)
    nis, nees = jax.jit(jax.vmap(lambda key: run(kalman, key)))(keys)
    size = kalman.model.layout.size
    for name, distances, degrees in (("NIS", nis, 1), ("NEES", nees, size)):
        means = np.asarray(distances).mean(axis=0)
        low, high = chi2.ppf([0.025, 0.975], RUNS * degrees) / RUNS
        inside = np.mean((low <= means) & (means <= high))
        assert inside > 0.85, (name, inside, means.mean(), degrees)
        assert means.mean() == pytest.approx(degrees, rel=0.05), name
