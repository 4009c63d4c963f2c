"""A reading that no noise explains is as if it were missing, unless it lasts."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest

from jaxtwin import Experiment, Twin, observe, simulate
from jaxtwin.observers import Observed, ProcessNoise
from jaxtwin.observers._kalman_filter import GATE_SIGMAS, MAX_REJECTED

pytestmark = pytest.mark.usefixtures("float64")

NOISE = ProcessNoise(reading=0.15)
SAMPLE = 200


@cache
def healthy(rig: str = "tclab") -> Experiment:
    """A run of five minutes with the noise of the rig's sensors."""
    twin = Twin(rig)
    plan = Experiment.schedule("0:0.3,120:0.6", duration=300, cells=len(twin.rig.driven))
    return simulate(twin, plan).to_recording(seed=1)


def observed(readings: np.ndarray, rig: str = "tclab", horizon: int | None = None) -> Observed:
    return observe(Twin(rig), replace(healthy(rig), temperatures=readings), NOISE, horizon=horizon)


def changed(
    value: float, samples: slice | int = SAMPLE, channels: slice | int = 0, rig: str = "tclab"
) -> np.ndarray:
    readings = np.array(healthy(rig).temperatures)
    readings[samples, channels] = value
    return readings


@pytest.mark.parametrize("channels", [0, slice(None)], ids=["one channel", "all channels"])
@pytest.mark.parametrize("value", [-127.0, 0.0, 85.0, 9999.0])
@pytest.mark.parametrize("horizon", [None, 3], ids=["filter", "moving horizon"])
def test_a_lone_impossible_reading_is_as_if_it_were_missing(
    value: float, channels: slice | int, horizon: int | None
) -> None:
    run = observed(changed(value, channels=channels), horizon=horizon)
    missing = observed(changed(np.nan, channels=channels), horizon=horizon)
    for ours, theirs in zip(
        jax.tree.leaves((run.filtered.states.mean, run.filtered.states.covariance)),
        jax.tree.leaves((missing.filtered.states.mean, missing.filtered.states.covariance)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)
    expected = np.zeros_like(run.rejected)
    expected[SAMPLE, channels] = True
    np.testing.assert_array_equal(run.rejected, expected)
    np.testing.assert_array_equal(run.impossible, expected)
    assert np.isnan(run.standardised[expected]).all()


def test_five_kelvins_are_rejected_and_noise_is_not() -> None:
    readings = np.array(healthy().temperatures)
    assert not observed(readings).rejected.any()
    run = observed(changed(readings[SAMPLE, 1] + 5.0, channels=1))
    assert run.impossible[SAMPLE, 1]


def test_what_lasts_is_followed_after_three_samples() -> None:
    """A sensor that has fallen off reads the room from then on."""
    run = observed(changed(20.0, slice(SAMPLE, None)))
    np.testing.assert_array_equal(
        np.flatnonzero(run.rejected[:, 0]), SAMPLE + np.arange(MAX_REJECTED)
    )
    assert not run.impossible.any()
    late = run.innovations[SAMPLE + MAX_REJECTED + 5 :, 0]
    assert np.abs(late).max() < 0.3 * abs(run.innovations[SAMPLE, 0])


def test_a_missing_reading_does_not_end_what_lasts() -> None:
    readings = changed(20.0, slice(SAMPLE, None))
    readings[SAMPLE + 1] = np.nan
    rejected = np.flatnonzero(observed(readings).rejected[:, 0])
    np.testing.assert_array_equal(rejected, SAMPLE + np.array([0, 2, 3]))


def test_glitches_of_every_second_sample_are_all_rejected() -> None:
    run = observed(changed(85.0, slice(SAMPLE, SAMPLE + 20, 2)))
    assert run.impossible[SAMPLE : SAMPLE + 20 : 2, 0].all()
    assert run.rejected.sum() == 10


def test_a_likelihood_does_not_gain_by_what_is_rejected() -> None:
    """A rejected reading counts with the density at the gate."""
    run, missing = observed(changed(85.0)), observed(changed(np.nan))
    spread = np.sqrt(run.innovation_covariance[SAMPLE, 0, 0])
    gate = -0.5 * (GATE_SIGMAS**2 + np.log(2 * np.pi)) - np.log(spread)
    assert run.log_likelihood - missing.log_likelihood == pytest.approx(gate, abs=1e-9)


def test_a_correction_of_the_camera_is_not_rejected() -> None:
    """All channels jump by 1 K, and the camera forgets it within some seconds."""
    readings = np.array(healthy("dual-cell").temperatures)
    readings[SAMPLE:] += np.exp(-np.arange(len(readings) - SAMPLE) / 10.0)[:, None]
    run = observe(Twin("dual-cell"), replace(healthy("dual-cell"), temperatures=readings))
    assert not run.rejected.any()
