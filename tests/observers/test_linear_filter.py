"""A filter linearised along a run is the filter itself where it was linearised, and close to it
with other levels of noise."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin, load_rig, simulate
from jaxtwin._jax_settings import own_settings
from jaxtwin.observers import ProcessNoise
from jaxtwin.observers._estimates import Moment
from jaxtwin.observers._filter_run import Filtered, FilterSamples, filtered, samples_of, started
from jaxtwin.observers._forecast import expected_ahead, starts_of
from jaxtwin.observers._kalman_filter import ExtendedKalmanFilter, KalmanState
from jaxtwin.observers._linear_filter import (
    LinearisedPath,
    LinearRun,
    filter_path,
    forecasts_of_path,
    linearised_path,
)
from jaxtwin.observers._observe import filter_for
from jaxtwin.observers._start import first_reading

HORIZON = 40.0


@dataclasses.dataclass(frozen=True)
class Run:
    """A recording, filtered and linearised."""

    kalman: ExtendedKalmanFilter
    start: KalmanState
    samples: FilterSamples
    filtered: Filtered
    path: LinearisedPath

    def with_levels(self, **levels: Any) -> ExtendedKalmanFilter:
        noise = dataclasses.replace(self.kalman.model.noise, **levels)
        return eqx.tree_at(lambda k: k.model.noise, self.kalman, noise)


@pytest.fixture(scope="module", params=["single-cell", "dual-cell"])
def run(request: pytest.FixtureRequest) -> Run:
    """The camera corrects itself, and a part of the recording has no readings."""
    twin = Twin(load_rig(request.param))
    drive = Experiment.schedule(
        "0:0.5,60:-0.3,120:0.8" if len(twin.rig.cells) == 1 else "0:0.5/0,60:-0.3/0.8",
        duration=200,
        cells=len(twin.rig.cells),
        ambient=23.0,
    )
    recording = simulate(twin, drive).to_recording(noise=0.15, seed=2)
    readings = np.array(recording.temperatures)
    readings[70:90] = np.nan
    readings[100:] += 2.5  # a correction of the camera
    recording = dataclasses.replace(recording, temperatures=readings)
    noise = ProcessNoise(jump_mean=0.4)
    kalman = filter_for(twin, recording, noise)
    samples, _ = samples_of(kalman, recording)
    with own_settings():
        start = started(
            kalman, np.asarray(first_reading(recording)), np.zeros_like(samples.duty[0])
        )
        run = filtered(kalman, start, samples)
        before = jax.tree.map(
            lambda first, rest: jnp.concatenate([jnp.asarray(first)[None], rest[:-1]]),
            start,
            run.states,
        )
        path = linearised_path(kalman, before, samples)
    return Run(kalman, start, samples, run, path)


def readings(run: Run, deviations: Any) -> np.ndarray:
    """In degC."""
    with own_settings():
        return np.asarray(run.kalman.model.to_degC(jnp.asarray(deviations)))


def linear(run: Run, kalman: ExtendedKalmanFilter) -> LinearRun:
    with own_settings():
        return eqx.filter_jit(filter_path)(kalman, run.path, run.start)


def forecasts(run: Run, kalman: ExtendedKalmanFilter) -> tuple[Moment, Moment]:
    """Those of the linear filter, and those of the filter, degC."""
    ends, counts = starts_of(run.samples, np.ones(len(run.samples.dt), bool), HORIZON)
    with own_settings():
        after = linear(run, kalman)
        steps = int(counts.max())
        by_path = eqx.filter_jit(forecasts_of_path)(kalman, run.path, after, ends, counts, steps)
        states = filtered(kalman, run.start, run.samples).states
        of_filter = expected_ahead(kalman, states, run.samples, ends, counts)
    return Moment(readings(run, by_path.mean), np.asarray(by_path.spread)), of_filter


def test_it_is_the_filter_where_it_was_linearised(run: Run):
    again = linear(run, run.kalman)
    expected = readings(run, again.expected)
    np.testing.assert_allclose(expected, run.filtered.expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        again.states.covariance, run.filtered.states.covariance, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        again.states.log_likelihood, run.filtered.states.log_likelihood, rtol=1e-7, atol=1e-7
    )


def test_other_levels_of_noise_move_it_as_they_move_the_filter(run: Run):
    """The filters differ by tenths of a kelvin, and their linearisation by a hundredth of it."""
    changed = run.with_levels(reading=0.3, disturbance=1.0, common=0.05, heat=0.6)
    with own_settings():
        of_linear, of_filter = linear(run, changed), filtered(changed, run.start, run.samples)
    expected = readings(run, of_linear.expected)
    moved = np.abs(np.asarray(of_filter.expected) - np.asarray(run.filtered.expected)).max()
    assert moved > 0.1
    np.testing.assert_allclose(expected, of_filter.expected, rtol=0, atol=0.01 * moved)
    np.testing.assert_allclose(
        np.asarray(of_linear.states.log_likelihood).sum(),
        np.asarray(of_filter.states.log_likelihood).sum(),
        rtol=1e-3,
    )


@pytest.mark.parametrize("levels", [{}, {"reading": 0.3, "disturbance": 1.0, "common": 0.05}])
def test_its_forecasts_are_those_of_the_filter(run: Run, levels: dict[str, float]):
    """Also across a correction of the camera, which the filter sees and an earlier forecast does
    not."""
    by_path, by_filter = forecasts(run, run.with_levels(**levels))
    np.testing.assert_allclose(by_path.mean, by_filter.mean, rtol=0, atol=0.02)
    np.testing.assert_allclose(by_path.spread, by_filter.spread, rtol=5e-3)
