"""A camera that corrects itself at equal intervals: the filter expects the next correction."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from small_rigs import CAMERA, small_rig_file

from jaxtwin import Experiment, Twin, observe, simulate
from jaxtwin.errors import RigError
from jaxtwin.observers import ExtendedKalmanFilter, Observed, ProcessNoise, live_observer
from jaxtwin.observers._expected_correction import expected_jump
from jaxtwin.rig import load_rig

pytestmark = pytest.mark.usefixtures("float64")

INTERVAL = 40.0
ERROR = """
[camera.common_error]
offset = "0.1 K"
drift = "0.1 K"
drift_time = "100 s"
jump = "0.5 K"
relaxation = ["10 s"]
"""
NOISE = ProcessNoise(jump=0.2, jump_mean=0.8, common=0.05, reading=0.05)


def camera_rig(folder: Path, interval: str) -> Path:
    contacts = [{"V11": "0.5 K/W"}]
    sensors = CAMERA + ERROR + interval
    return small_rig_file(folder, ["4 cm", "4 cm"], ["4 cm"], contacts, sensors=sensors)


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Twin:
    path = camera_rig(tmp_path_factory.mktemp("rig"), f'interval = "{INTERVAL} s"')
    return Twin(load_rig(path))


@pytest.fixture(scope="module")
def kalman(twin: Twin) -> ExtendedKalmanFilter:
    with jax.enable_x64(True):
        return live_observer(twin, NOISE, sample_time=1.0)


@settings(max_examples=20, deadline=None)
@given(steps=some.lists(some.floats(0.1, 30.0), min_size=2, max_size=30))
def test_the_means_of_all_steps_of_an_interval_are_one_correction(
    kalman: ExtendedKalmanFilter, steps: list[float]
):
    times = np.cumsum(np.append(0.0, steps))
    times = 0.5 * INTERVAL + times * INTERVAL / times[-1]
    with jax.enable_x64(True):
        jumps = [
            expected_jump(kalman.model, jnp.asarray(start), jnp.asarray(end - start))
            for start, end in pairwise(times)
        ]
    fading = kalman.model.layout.fading
    assert sum(jump.mean[fading] for jump in jumps) == pytest.approx([0.8], rel=1e-9)
    others = [np.delete(np.asarray(part), fading) for jump in jumps for part in jump]
    assert not np.any(others)


def test_a_step_over_the_expected_time_adds_mean_and_variance_of_a_correction(
    kalman: ExtendedKalmanFilter,
):
    jump = expected_jump(kalman.model, jnp.asarray(30.0), jnp.asarray(20.0))
    fading = kalman.model.layout.fading
    assert jump.mean[fading] == pytest.approx([0.8])
    assert jump.variance[fading] == pytest.approx([0.04])


@pytest.mark.parametrize("since", [np.inf, 0.0])
def test_nothing_is_expected_of_a_camera_that_has_just_corrected_itself_or_never_did(
    kalman: ExtendedKalmanFilter, since: float
):
    jump = expected_jump(kalman.model, jnp.asarray(since), jnp.asarray(5.0))
    assert not np.any(np.concatenate(jump))


def jumping(twin: Twin, duration: float = 200.0) -> Experiment:
    """A rig at rest whose camera jumps by 0.8 K in each interval, for the first time after half of
    it; each jump fades."""
    plan = Experiment.schedule("0:0", duration=duration, cells=1, ambient=20.0)
    recording = simulate(twin, plan).to_recording(noise=0.05, seed=4)
    error = true_error(recording.time)
    assert recording.temperatures is not None
    return dataclasses.replace(recording, temperatures=recording.temperatures + error[:, None])


@pytest.fixture(scope="module")
def observed(twin: Twin) -> Observed:
    with jax.enable_x64(True):
        return observe(twin, jumping(twin), NOISE)


def test_the_clock_starts_with_the_first_jump_that_is_seen(observed: Observed):
    since = np.asarray(observed.filtered.states.since_correction)
    assert np.all(np.isinf(since[:20]))
    assert since[20] == 0.0
    assert since[-1] == pytest.approx(180.0)


def test_forecasts_expect_the_corrections_to_come(observed: Observed):
    """Without an interval, each correction is a surprise that is ten standard deviations large."""
    ahead = observed.ahead(20.0).after(41.0)
    assert ahead.rmse < 0.12
    assert ahead.coverage > 0.9
    width = np.asarray(ahead.upper - ahead.lower)[:, 0]
    at = (ahead.time + 0.5 * INTERVAL) % INTERVAL
    # Around a correction, and when its jump has faded.
    assert width[at < 5].mean() > 1.5 * width[at > 30].mean()


def test_a_forecast_is_what_single_steps_say(observed: Observed):
    """The means of `ahead` and of `forecast` from the same time, and their bands."""
    from_then = observed.forecast(20.0, at=110.0)
    ahead = observed.ahead(20.0)
    place = int(np.searchsorted(ahead.time, 130.0))
    assert ahead.mean[place] == pytest.approx(from_then.mean[-1], abs=1e-9)
    assert ahead.upper[place] == pytest.approx(from_then.upper[-1], abs=2e-3)


def test_smoothing_knows_the_corrections(observed: Observed):
    common = observed.smooth().common_error
    assert np.sqrt(np.mean((common.mean - true_error(observed.time)) ** 2)) < 0.1


def true_error(time: np.ndarray) -> np.ndarray:
    since = (time + 0.5 * INTERVAL) % INTERVAL
    return np.where(time < 0.5 * INTERVAL, 0.0, 0.8 * np.exp(-since / 10.0))


@pytest.mark.parametrize("interval", ["0 s", "-3 s", "3 K"])
def test_an_interval_that_is_no_time_is_refused(tmp_path: Path, interval: str):
    path = camera_rig(tmp_path, f'interval = "{interval}"')
    with pytest.raises(RigError, match=r"camera\.common_error\.interval: expected"):
        load_rig(path)
