"""The error of the model itself, learnt from predictions of a recording's later part."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pot import pot_tables

import jaxtwin as jt
from jaxtwin.matching import ModelError
from jaxtwin.rig import rig_from_tables

# Name -> value, unit and bounds.
FREE = {
    "C": (900, "J/K", [90, 9000]),
    "R": (0.25, "K/W", [0.02, 2.5]),
    "C_wall": (6000, "J/K", [600, 60000]),
    "R_wall": (0.2, "K/W", [0.02, 2]),
}


def tables() -> dict[str, Any]:
    parameters = {
        name: {"value": value, "unit": unit, "bounds": bounds, "free": True}
        for name, (value, unit, bounds) in FREE.items()
    }
    return {**pot_tables(*FREE), "parameters": parameters}


def without_wall() -> jt.Twin:
    pot = tables()
    del pot["bodies"][1], pot["links"][1]
    del pot["parameters"]["C_wall"], pot["parameters"]["R_wall"]
    return jt.Twin(rig_from_tables(pot, "pot without wall"))


@pytest.fixture(scope="module")
def device():
    return jt.Twin(rig_from_tables(tables(), "pot"))


@pytest.fixture(scope="module")
def recording(device):
    schedule = "0:0,200:0.5,900:0.2,1500:0.8,2300:0.1,2900:0.5,3600:0.9,4400:0.1"
    plan = jt.Experiment.schedule(schedule, duration=5400, step=10.0, cells=1)
    return jt.simulate(device, plan).to_recording(seed=3, name="pot")


def coverage_and_width(fit, recording, split):
    later = jt.prediction_band(fit, fit.recordings[0], experiment=recording).between(split)
    return float(later.coverage[0]), float(later.width[0])


def test_a_network_that_lacks_a_body_has_a_band_that_holds(recording):
    fit = jt.match(without_wall(), recording.between(None, 3000.0))
    plain = replace(fit, model_error=ModelError())
    assert coverage_and_width(plain, recording, 3000.0)[0] < 0.6
    covered, width = coverage_and_width(fit, recording, 3000.0)
    assert covered > 0.85
    # Not wider than needed: that of a normal distribution is four times its standard deviation.
    errors = jt.simulate(fit.twin, recording).temperatures - recording.temperatures
    assert width < 5 * np.sqrt(np.mean(errors[recording.time >= 3000.0] ** 2))


def test_the_right_network_keeps_its_band(device, recording):
    fit = jt.match(device, recording.between(None, 3000.0))
    _, plain = coverage_and_width(replace(fit, model_error=ModelError()), recording, 3000.0)
    covered, width = coverage_and_width(fit, recording, 3000.0)
    assert covered > 0.9
    assert width < 1.3 * plain


def test_inside_the_matched_recording_nothing_is_added(recording):
    fit = jt.match(without_wall(), recording)
    band = jt.prediction_band(fit)
    plain = jt.prediction_band(replace(fit, model_error=ModelError()))
    np.testing.assert_allclose(band.upper, plain.upper)


def test_it_is_saved_with_the_fit(recording, tmp_path):
    fit = jt.match(without_wall(), recording)
    assert fit.model_error.growth["water"] > 0
    fit.save(tmp_path / "fit.toml")
    again = jt.Fit.load(tmp_path / "fit.toml", rig=without_wall().rig)
    assert again.model_error == fit.model_error


def test_it_grows_with_time_up_to_a_limit_and_outside_of_what_was_matched():
    error = ModelError({"a": 0.1}, {"a": 2.0}, {"a": 20.0}, {"a": 40.0}, extrapolation=0.5)
    ahead = np.array([0.0, 10.0, 1000.0, 0.0])
    predicted = np.array([[30.0, 0.0], [30.0, 0.0], [30.0, 0.0], [44.0, 0.0]])
    variance = error.variance(ahead, predicted, ("a", "another"))
    np.testing.assert_allclose(variance[:, 0], [0.0, 1.0, 4.0, 4.0])
    np.testing.assert_allclose(variance[:, 1], 0.0)


def test_the_right_network_predicts_the_later_part_within_its_noise(device, recording):
    """As a match to the first part does, which the linear step stands for."""
    fit = jt.match(device, recording)
    first = jt.match(device, recording.between(None, 2700.0))
    later = recording.between(2700.0)
    errors = jt.simulate(first.twin, recording).between(2700.0).temperatures - later.temperatures
    by_match = float(np.mean(errors**2))
    growth = fit.model_error.growth["water"]
    assert by_match == pytest.approx(0.01, rel=0.3)
    assert growth * 2700.0 < 0.1
