"""The filter of a nonlinear twin is the square-root Kalman filter of cuthbertlib on its linearised
steps and readings."""

import dataclasses

import jax
import numpy as np
import pytest
from cuthbertlib.kalman.filtering import predict, update

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.observers import ProcessNoise
from jaxtwin.observers._filter_run import following, samples_of
from jaxtwin.observers._gaussian import CAUTION_SIGMAS
from jaxtwin.observers._observe import filter_for

pytestmark = pytest.mark.usefixtures("float64")


def root_of(covariance: np.ndarray) -> np.ndarray:
    """A square root, also where the covariance is singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.clip(values, 0.0, None))


@pytest.mark.slow
def test_means_covariances_and_likelihood_are_those_of_cuthbertlib():
    """Two cells with a driver's lag, fifteen channels of which a tenth is missing."""
    twin = Twin("dual-cell")
    drive = Experiment.schedule("0:0.6/0.2,20:-0.3/0.5", duration=40, cells=2)
    recording = simulate(twin, drive).to_recording(noise=0.1, seed=3)
    assert recording.temperatures is not None
    missing = np.random.default_rng(4).uniform(size=recording.temperatures.shape) < 0.1
    readings = np.where(missing, np.nan, recording.temperatures)
    recording = dataclasses.replace(recording, temperatures=readings)
    kalman = filter_for(twin, recording, ProcessNoise())
    samples, _ = samples_of(kalman, recording)
    start = jax.jit(lambda: kalman.init(np.nanmean(readings[0]), np.zeros(2)))()

    @jax.jit
    def run():
        found, steps = following(kalman, start, samples)
        before = jax.tree.map(
            lambda first, rest: jax.numpy.concatenate([first[None], rest[:-1]]), start, found.states
        )
        ahead = jax.vmap(kalman.step)(before, samples.duty, samples.dt)
        there = np.isfinite(samples.readings)
        seen = jax.vmap(kalman.model.read)(ahead.mean)
        measured = jax.vmap(kalman.measured)(ahead, seen, samples.readings, there, samples.ambient)
        slopes = jax.vmap(lambda step: step.slope)(steps)
        return found, steps, slopes, before, ahead, measured, jax.vmap(kalman.expected)(ahead.mean)

    found, steps, slopes, before, ahead, measured, expected = jax.tree.map(np.asarray, run())
    assert not measured.added_variance.any()
    assert np.abs(found.states.whitened).max() < CAUTION_SIGMAS
    to_next, corrected = jax.jit(predict), jax.jit(update)
    mean, root = np.asarray(start.mean), root_of(np.asarray(start.covariance))
    for k, F in enumerate(slopes):
        drift = steps.mean[k] - F @ before.mean[k]
        mean, root = to_next(mean, root, F, drift, root_of(steps.noise[k]))
        H, readings = expected.slope[k], np.where(measured.mask[k], measured.values[k], np.nan)
        offset = expected.mean[k] - H @ ahead.mean[k]
        spreads = np.diag(np.sqrt(measured.variance[k]))
        (mean, root), likelihood = corrected(mean, root, H, offset, spreads, readings)
        np.testing.assert_allclose(mean, found.states.mean[k], rtol=0, atol=1e-9)
        covariance = np.asarray(root @ root.T)
        np.testing.assert_allclose(covariance, found.states.covariance[k], rtol=0, atol=1e-9)
        assert likelihood == pytest.approx(found.states.log_likelihood[k], abs=1e-7)
