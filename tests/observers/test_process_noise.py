"""Levels of noise: written and read, checked, and found from a recording."""

import dataclasses
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.errors import ObserverError
from jaxtwin.observers import ProcessNoise, _estimate_noise, estimate_noise
from jaxtwin.observers._process_noise import SIGNED_LEVELS, SPREADS

LEVELS = tuple(ProcessNoise().levels())
POSITIVE = some.floats(min_value=1e-300, max_value=1e300, allow_subnormal=False)
NAMES = some.lists(some.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True), max_size=3)


ERRORS = some.dictionaries(some.sampled_from(tuple(SPREADS)), POSITIVE)


@settings(max_examples=50)
@given(levels=some.dictionaries(some.sampled_from(LEVELS), POSITIVE), names=NAMES, errors=ERRORS)
def test_a_file_keeps_each_level_to_the_last_bit(
    levels: dict[str, float], names: list[str], errors: dict[str, float]
):
    noise = ProcessNoise(**levels, names=tuple(names), standard_errors=errors)
    with tempfile.TemporaryDirectory() as folder:
        found = ProcessNoise.load(noise.save(Path(folder) / "noise.toml"))
    assert found.levels() == noise.levels()
    assert found.names == noise.names
    assert found.standard_errors == errors


def test_a_level_that_a_file_does_not_state_keeps_its_default(tmp_path: Path):
    path = tmp_path / "noise.toml"
    path.write_text("heat = 2\n", encoding="utf-8")
    assert ProcessNoise.load(path).levels() == ProcessNoise(heat=2.0).levels()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("heat = -1.0", "heat: expected a number above 0, got -1.0"),
        ("heat = 0", "heat: expected a number above 0, got 0"),
        ("heat = nan", "heat: expected a number above 0, got nan"),
        ("heat = inf", "heat: expected a number above 0, got inf"),
        ("heat = true", "heat: expected a number above 0, got True"),
        ('heat = "0.1"', "heat: expected a number above 0, got '0.1'"),
        ("hat = 0.1", "hat: expected levels of noise, got 0.1"),
        ('names = "R_1"', "names: expected a list of parameters, got 'R_1'"),
        ("names = [1]", r"names: expected a list of parameters, got \[1\]"),
        ("standard_errors = 1", "standard_errors: expected a table, got 1"),
        ("[standard_errors]\nhat = 1", r"standard_errors\.hat: expected levels of noise, got 1"),
        ("[standard_errors]\nheat = 0", r"standard_errors\.heat: expected a number above 0, got 0"),
        ("jump_mean = nan", "jump_mean: expected a finite number, got nan"),
        ("heat = = 1", "expected levels of noise as TOML"),
    ],
)
def test_a_wrong_entry_is_refused_by_file_and_name(tmp_path: Path, text: str, message: str):
    path = tmp_path / "noise.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ObserverError, match=rf"noise\.toml: {message}"):
        ProcessNoise.load(path)


def test_a_file_that_is_missing_is_refused_by_name(tmp_path: Path):
    with pytest.raises(ObserverError, match=r"none\.toml: expected levels of noise as TOML"):
        ProcessNoise.load(tmp_path / "none.toml")


@pytest.mark.parametrize("name", [name for name in LEVELS if name not in SIGNED_LEVELS])
@pytest.mark.parametrize("level", [-0.1, 0.0, float("nan"), float("inf")])
def test_each_level_has_to_be_a_number_above_zero(name: str, level: float):
    noise = dataclasses.replace(ProcessNoise(), **{name: level})
    with pytest.raises(ObserverError, match=rf"noise: {name}: expected a number above 0, got"):
        noise.check()
    dataclasses.replace(noise, **{name: 0.1}).check()


def test_the_mean_of_a_jump_may_have_either_sign(tmp_path: Path):
    noise = ProcessNoise(jump_mean=-0.3)
    noise.check()
    assert ProcessNoise.load(noise.save(tmp_path / "noise.toml")).levels()["jump_mean"] == -0.3
    with pytest.raises(ObserverError, match="noise: jump_mean: expected a finite number, got inf"):
        ProcessNoise(jump_mean=np.inf).check()


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


@pytest.fixture(scope="module")
def recording(twin: Twin) -> Experiment:
    drive = Experiment.schedule("0:0.5/0,60:0.2/0.8", duration=120, cells=2)
    return simulate(twin, drive).to_recording(noise=0.15, seed=2)


@pytest.mark.slow
def test_the_noise_of_readings_is_found_from_a_recording(
    twin: Twin, recording: Experiment, monkeypatch: pytest.MonkeyPatch
):
    """Within a fifth, from twice as much. What the recording does not have becomes smaller."""
    monkeypatch.setattr(_estimate_noise, "ITERATIONS", 15)
    start = ProcessNoise(reading=0.3, heat=0.05, disturbance=0.1, channel=0.05, common=0.05)
    found = estimate_noise(twin, recording, start=start, horizons=[20.0])
    levels = found.levels()
    assert 0.12 < levels["reading"] < 0.18
    assert levels["disturbance"] < 0.1
    assert levels["room"] == start.levels()["room"]
    errors = found.standard_errors
    assert abs(np.log(levels["reading"] / 0.15)) < 2 * errors["reading"] < 0.6
    assert 0.9 < max(error / SPREADS[name] for name, error in errors.items()) <= 1.0
    said = found.summary()
    assert re.search(r"\nreading +0\.1\d+ +K +\d+ +found\n", said)
    assert "assumed, the recordings do not show it" in said
    assert "not estimated" in said


def test_the_search_does_not_stop_at_a_maximum_that_is_not_the_highest(
    twin: Twin, recording: Experiment, monkeypatch: pytest.MonkeyPatch
):
    """Two maxima of one level, of heights 0.3 and 1: the lower one is nearer to the start."""
    start = ProcessNoise()

    def score(names: tuple[str, ...], logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        place = names.index("common")
        at = (logarithms[place] - np.log(start.levels()["common"])) / SPREADS["common"]
        places, heights = np.array([0.5, -1.2]), np.array([0.3, 1.0])
        parts = heights * np.exp(-5 * (at - places) ** 2)
        slope = np.zeros(len(names))
        slope[place] = -10 * (parts @ (at - places)) / parts.sum() / SPREADS["common"]
        return 6 * np.log(parts.sum()), 6 * slope

    monkeypatch.setattr(
        _estimate_noise, "_scored", lambda *arguments: score(arguments[1], arguments[3])
    )
    found = estimate_noise(twin, recording, start=start, horizons=[20.0])
    assert np.log(found.levels()["common"] / 0.2) / SPREADS["common"] == pytest.approx(
        -1.2, abs=0.1
    )


def test_a_recording_that_is_not_longer_than_the_horizon_is_refused(
    twin: Twin, recording: Experiment
):
    with pytest.raises(ObserverError, match="longer than the horizon of 300 s, got 120 s"):
        estimate_noise(twin, recording, horizons=[300.0])


def test_the_next_jump_of_a_camera_is_known_no_better_than_its_mean():
    errors = {"jump": 0.3, "jump_mean": 0.4}
    found = _estimate_noise._predictive({"jump": 0.3, "jump_mean": 0.2}, errors)
    assert found == {"jump": pytest.approx(0.5), "jump_mean": 0.2}
    assert _estimate_noise._predictive({"common": 0.2}, {"common": 0.1}) == {"common": 0.2}


@pytest.mark.parametrize("horizons", [[], [0.0], [60.0, -1.0], 0.0])
def test_horizons_that_are_no_times_are_refused(twin: Twin, recording: Experiment, horizons: Any):
    with pytest.raises(ObserverError, match="horizons: expected one time above 0 s or more, got"):
        estimate_noise(twin, recording, horizons=horizons)


def test_a_parameter_that_does_not_exist_cannot_drift(twin: Twin, recording: Experiment):
    with pytest.raises(ObserverError, match=r"names: expected parameters of .*got 'R_7'"):
        estimate_noise(twin, recording, names=["R_7"])


@given(
    samples=some.integers(1, 50_000),
    most=some.integers(64, 4_000),
    longest=some.integers(1, 1_000),
)
def test_stretches_have_room_for_a_forecast_and_are_spread_over_a_recording(
    samples: int, most: int, longest: int
):
    rows = _estimate_noise._stretches(samples, most, longest)
    assert (np.diff(rows, axis=1) == 1).all()
    assert rows[0, 0] == 0
    assert len(rows) == 1 or rows[-1, -1] == samples - 1
    assert rows.shape[1] >= min(2 * longest, samples)
    assert (np.diff(rows[:, 0]) >= rows.shape[1]).all()
    if samples <= most:
        assert len(rows) == 1


@given(seconds=some.floats(0.0, 1e6), horizon=some.floats(1.0, 1e4), ratio=some.floats(1.0, 1e3))
def test_a_longer_horizon_has_fewer_forecasts(seconds: float, horizon: float, ratio: float):
    shortest = _estimate_noise._forecasts(seconds, horizon, horizon)
    longer = _estimate_noise._forecasts(seconds, ratio * horizon, horizon)
    assert 1 <= longer <= shortest <= _estimate_noise.MAX_FORECASTS


def test_a_level_of_0_has_no_relative_error():
    noise = ProcessNoise(standard_errors={"jump_mean": 0.1})
    assert re.search(r"\njump_mean +0 +K +(found|assumed)", noise.summary())
