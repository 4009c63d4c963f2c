"""Predictions of what a match has not seen: on recordings whose truth is known."""

import json

import numpy as np
import pytest
import small_results

from jaxtwin import (
    Experiment,
    ProcessNoise,
    Twin,
    leave_one_out,
    simulate,
    validate,
    validate_split,
)
from jaxtwin.errors import MatchError, SimulationError
from jaxtwin.matching import estimate_initial_conditions
from jaxtwin.validation import Validation
from jaxtwin.validation._validate import _beyond_given

FREE = ["C_load", "T_amb", "T_start", "T_sink"]
NOISE = 0.05


def recording(
    schedule: str, ambient: float, start: float, seed: int = 0, name: str = "day"
) -> Experiment:
    """Four minutes of a known single cell, load and sink alike at the start, with white noise."""
    drive = Experiment.schedule(schedule, duration=240)
    at_start = {"T_amb": ambient, "T_start": start, "T_sink": start}
    truth = Twin("single-cell", {"C_load": 24.0, **at_start})
    seen = simulate(truth, drive).temperatures
    seen = seen + NOISE * np.random.default_rng(seed).standard_normal(seen.shape)
    return Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen, name=name)


def spoiled(recording: Experiment, start: float) -> Experiment:
    """The same with other temperatures from a time on."""
    assert recording.temperatures is not None
    seen = recording.temperatures + np.where(recording.time >= start, 30.0, 0.0)[:, None]
    return Experiment(
        recording.time, recording.duty, channels=("T",), temperatures=seen, name=recording.name
    )


# As many switches each, so that they share compiled code.
LATE, EARLY = "70:0.4,150:-0.3", "0:0.4,70:0.3,150:-0.3"
SPLIT = 160.0


@pytest.fixture(scope="module")
def truth() -> Twin:
    return Twin("single-cell", {"C_load": 24.0})


@pytest.fixture(scope="module")
def days() -> list[Experiment]:
    return [
        recording(LATE, 20.0, 18.5, 1, "monday"),
        recording(LATE, 22.0, 22.0, 2, "tuesday"),
        recording(EARLY, 17.0, 16.0, 3, "wednesday"),
    ]


@pytest.fixture(scope="module")
def split(days: list[Experiment]) -> Validation:
    return validate_split(Twin("single-cell"), days[:2], SPLIT, free=FREE)


@pytest.fixture(scope="module")
def crossed(days: list[Experiment]) -> Validation:
    return leave_one_out(Twin("single-cell"), days[:2], free=FREE)


@pytest.mark.slow
def test_a_group_is_predicted_by_the_other_groups_alone(days: list[Experiment]):
    """Monday twice and Tuesday: what happened on a day changes nothing in its prediction."""
    groups = ["monday", "tuesday", "monday"]
    result = leave_one_out(Twin("single-cell"), days, free=FREE, groups=groups, by="group")
    assert [prediction.name for prediction in result.predictions] == [
        "monday",
        "wednesday",
        "tuesday",
    ]
    assert [prediction.fit and prediction.fit.recordings for prediction in result.predictions] == [
        ("tuesday",),
        ("tuesday",),
        ("monday", "wednesday"),
    ]
    assert "a match to the other groups" in result.kind
    assert result.rmse < 1.0


@pytest.mark.slow
def test_the_true_rig_predicts_an_unseen_day_to_the_noise(truth: Twin, days: list[Experiment]):
    """Ambient and start come from the first minute, in which the drive is off."""
    result = validate(truth, days[1])
    (prediction,) = result.predictions
    assert prediction.run.time[0] == 60.0
    # At rest the start is read off; the room's temperature is known from the drift alone.
    assert prediction.estimated["T_start"] == pytest.approx(22.0, abs=0.3)
    assert prediction.estimated["T_amb"] == pytest.approx(22.0, abs=0.5)
    assert result.rmse < 0.5


@pytest.mark.slow
def test_ambient_and_start_are_found_with_the_drive_on_from_the_start(
    truth: Twin, days: list[Experiment]
):
    (prediction,) = validate(truth, days[2]).predictions
    assert prediction.estimated["T_start"] == pytest.approx(16.0, abs=1.0)
    assert prediction.estimated["T_amb"] == pytest.approx(17.0, abs=1.0)


@pytest.mark.slow
def test_a_plate_that_is_warmer_than_its_room_shows_it_by_cooling(truth: Twin):
    """Five kelvin between the two, far more than expected beforehand."""
    quick = truth.with_values({"R_loss": 0.5})
    drive = Experiment.schedule(LATE, duration=240)
    seen = simulate(quick.with_values({"T_amb": 20.0, "T_start": 25.0}), drive).temperatures
    warm = Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen)
    found = estimate_initial_conditions(quick, warm).values
    assert found["T_amb"] == pytest.approx(20.0, abs=1.0)
    assert found["T_start"] == pytest.approx(25.0, abs=1.0)


@pytest.mark.slow
def test_nothing_after_the_warm_up_is_looked_at(truth: Twin, days: list[Experiment]):
    honest = validate(truth, days[0]).predictions[0]
    other = validate(truth, spoiled(days[0], 60.0)).predictions[0]
    assert other.estimated == honest.estimated
    np.testing.assert_array_equal(other.run.temperatures, honest.run.temperatures)


@pytest.mark.slow
def test_a_fit_predicts_a_day_that_it_has_not_seen(crossed: Validation, days: list[Experiment]):
    fit = crossed.predictions[0].fit
    assert fit is not None
    result = validate(fit, days[2])
    assert set(result.predictions[0].estimated) == {"T_amb", "T_start", "T_sink"}
    assert result.mean_fit_percent > 90


@pytest.mark.slow
def test_a_match_never_sees_what_it_has_to_predict(split: Validation, days: list[Experiment]):
    other = validate_split(
        Twin("single-cell"), [spoiled(day, SPLIT) for day in days[:2]], SPLIT, free=FREE
    )
    first, second = split.predictions[0].fit, other.predictions[0].fit
    assert first is not None
    assert second is not None
    values = [[row.value for row in fit.parameters.values()] for fit in (first, second)]
    assert values[0] == values[1]
    assert first.experiments[0].time[-1] < SPLIT <= split.predictions[0].run.time[0]
    assert other.rmse > 25


@pytest.mark.slow
def test_a_twin_matched_to_the_first_part_predicts_the_rest_to_the_noise(split: Validation):
    assert split.rmse < 3 * NOISE
    assert [prediction.name for prediction in split.predictions] == ["monday", "tuesday"]


@pytest.mark.slow
def test_each_recording_is_predicted_by_a_match_to_the_others(crossed: Validation):
    for prediction, other in zip(crossed.predictions, ("tuesday", "monday"), strict=True):
        assert prediction.fit is not None
        assert prediction.fit.recordings == (other,)
        assert prediction.fit["C_load"].value == pytest.approx(24.0, rel=0.05)


@pytest.mark.slow
def test_residuals_of_the_truth_itself_are_white(truth: Twin, days: list[Experiment]):
    """Noise alone is left, and the test of whiteness says so."""
    exact = truth.with_values({"T_amb": 20.0, "T_start": 18.5, "T_sink": 18.5})
    (prediction,) = validate(exact, days[0], names=[]).predictions
    assert prediction.whiteness["T"].is_white
    assert prediction.run.rmse == pytest.approx(NOISE, rel=0.2)


def test_numbers_are_plain_and_complete(truth: Twin, days: list[Experiment]):
    result = validate(truth, days)
    numbers = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert list(numbers["recordings"]) == ["monday", "tuesday", "wednesday"]
    monday = numbers["recordings"]["monday"]
    assert (monday["from_s"], monday["to_s"]) == (60.0, 240.0)
    assert monday["channels"]["T"]["fit_percent"] == pytest.approx(
        result.fit_percent["monday", "T"]
    )
    text = result.summary()
    assert all(name in text for name in ("monday", "wednesday", "T_amb", "white?"))


def test_predictions_that_cannot_be_made_say_why(truth: Twin, days: list[Experiment]):
    with pytest.raises(MatchError, match=r"monday: split at 5 s: .* got 5 .*0 to 240 s"):
        validate_split(truth, days[0], 5.0)
    with pytest.raises(MatchError, match=r"split at 230 s: .* got 230 and 11"):
        validate_split(truth, days[0], 230.0)
    with pytest.raises(MatchError, match=r"warm_up = 230 s: .* got 11"):
        validate(truth, days[0], warm_up=230.0)
    with pytest.raises(
        MatchError, match=r"warm_up = 0\.5 s: expected at least .* samples .* got 1"
    ):
        validate(truth, days[0], warm_up=0.5)
    with pytest.raises(MatchError, match="leave_one_out: expected two recordings or more, got 1"):
        leave_one_out(truth, days[:1])
    with pytest.raises(MatchError, match="expected recorded temperatures"):
        validate(truth, Experiment.schedule("0:0.5", duration=240, channels=("T",)))
    time = np.arange(100.0)
    two_cells = Experiment(time, np.zeros((100, 2)), channels=("T",), temperatures=time[:, None])
    with pytest.raises(SimulationError, match="expected the 1 cell of single-cell, got 2"):
        validate(truth, [days[0], two_cells])


@pytest.mark.slow
def test_events_and_masks_behind_the_split_are_left_out(days: list[Experiment]):
    masks = {"monday": [(10.0, 20.0), (150.0, 220.0, 0.5), (200.0, 220.0)]}
    start = Twin("single-cell")
    result = validate_split(start, days[:2], SPLIT, free=FREE, masks=masks, max_iterations=3)
    fit = result.predictions[0].fit
    assert fit is not None
    weight = fit.weights["monday"][:, 0]
    assert np.all(weight[10:21] == 0)
    assert np.all(weight[150:] == 0.5)
    assert len(weight) == 160


@pytest.mark.slow
def test_a_recording_of_the_match_is_called_matched_and_not_predicted(
    crossed: Validation, days: list[Experiment]
):
    fit = crossed.predictions[0].fit
    assert fit is not None
    (seen,) = fit.experiments
    result = validate(fit, seen)
    assert result.kind == "matched, not a prediction"
    assert f"{seen.name}: matched, not a prediction" in result.summary()
    assert result.to_dict()["recordings"][seen.name]["is_matched"]
    both = validate(fit, [seen, days[2]])
    assert both.kind.startswith("predicted after")
    assert [part.is_matched for part in both.predictions] == [True, False]


NOISY = ProcessNoise(reading=NOISE, reading_time=0.01, common=0.01, heat=0.05, disturbance=0.02)


@pytest.mark.slow
def test_an_observer_forecasts_the_rest_from_what_it_was_given(
    crossed: Validation, days: list[Experiment]
):
    fit = crossed.predictions[0].fit
    assert fit is not None
    result = validate(fit, days[2], noise=NOISY)
    assert result.kind == "forecast after the first 60 s"
    assert result.rmse < 6 * NOISE
    assert result.coverage > 0.9
    assert result.band_width < 30 * NOISE
    assert set(result.predictions[0].estimated) <= {"T_amb", "T_start", "T_sink"}
    spoilt = validate(fit, spoiled(days[2], 60.0), noise=NOISY)
    run = result.predictions[0].run
    np.testing.assert_array_equal(spoilt.predictions[0].run.temperatures, run.temperatures)
    assert run.states.shape == (len(run.time), len(run.nodes))
    assert run.time[0] == 60.0


@pytest.mark.slow
def test_an_observer_forecasts_after_the_values_of_a_new_day_were_matched(
    crossed: Validation, days: list[Experiment]
):
    fit = crossed.predictions[0].fit
    assert fit is not None
    result = validate(fit, days[2], given=120, noise=NOISY)
    assert result.kind == "forecast after the first 120 s, from which its group follows"
    assert result.rmse < 4 * NOISE
    assert result.coverage > 0.9


def test_an_observer_needs_a_fit_and_estimates_the_start_itself(truth: Twin, days):
    with pytest.raises(MatchError, match="noise: beside it: expected a Fit, got"):
        validate(truth, days[0], noise=NOISY)
    with pytest.raises(MatchError, match="expected no names and initial beside it"):
        validate(small_results.fit(), days[0], noise=NOISY, initial=20.0)


@pytest.mark.slow
def test_the_width_of_a_band_stands_beside_its_coverage(split: Validation, truth: Twin):
    bands = split.bands
    assert list(bands) == ["monday", "tuesday"]
    numbers = split.to_dict()
    monday = numbers["recordings"]["monday"]["channels"]["T"]
    assert monday["band_width_K"] == pytest.approx(bands["monday"].width[0])
    assert monday["coverage_of_95_percent_band"] == pytest.approx(bands["monday"].coverage[0])
    assert numbers["band_width_K"] == pytest.approx(split.band_width)
    assert 0.9 < split.coverage <= 1.0
    said = f"{100 * split.coverage:.1f} % inside 95 % bands of {split.band_width:.2f} K mean width"
    assert said in split.summary()
    assert said in repr(split)
    assert split.to_dataframe()["width"].to_list() == pytest.approx(
        [band.width[0] for band in bands.values()]
    )


def test_a_twin_that_is_no_fit_has_no_band(truth: Twin, days: list[Experiment]):
    result = validate(truth, days[1])
    assert result.bands == {}
    assert result.to_dict()["band_width_K"] is None
    assert "95 % bands" not in repr(result)


def test_a_prediction_far_outside_of_what_was_given_is_warned_of():
    """A plate that has come half its way in the given part, and one that is there already."""
    time = np.arange(100.0)
    on_its_way = 20 + 30 * (1 - np.exp(-time / 29))[:, None]
    (warning,) = _beyond_given(on_its_way, time < 20, 20.0)
    # 30 (1 - exp(-19 / 29)) = 14.4 K of 29.0 K.
    assert "up to 14.6 K outside of the first 20 s, whose range is 14.4 K" in warning
    assert _beyond_given(on_its_way, time < 60, 60.0) == ()
    idle = np.where(time < 50, 20.0, 21.0)[:, None]
    assert len(_beyond_given(idle, time < 50, 50.0)) == 1
