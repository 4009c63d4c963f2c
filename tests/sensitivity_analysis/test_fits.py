"""Studies around a fit: each recording under its own values."""

from dataclasses import replace

import pytest
from small_results import fit, recordings

from jaxtwin import Experiment, Twin, read_recording, sensitivity, validate
from jaxtwin.data import synthetic_recordings
from jaxtwin.errors import SimulationError
from jaxtwin.sensitivity_analysis._outputs import paired_twins


def ambients(twins: list[Twin]) -> list[float]:
    return [float(twin.values["T_amb"]) for twin in twins]


@pytest.fixture(scope="module")
def matched() -> list[float]:
    """The ambient temperatures of the fit, which differ."""
    first, second = (values["T_amb"] for values in fit().recording_values.values())
    assert abs(first - second) > 1
    return [first, second]


def test_matched_recordings_have_their_own_values_whatever_their_order_and_names(matched):
    twins, experiments = paired_twins("study", fit(), None)
    assert (ambients(twins), tuple(experiments)) == (matched, recordings())
    renamed = [replace(recording, name="copy") for recording in reversed(recordings())]
    twins, _ = paired_twins("study", fit(), renamed)
    assert ambients(twins) == matched[::-1]


@pytest.mark.slow
def test_an_unseen_recording_has_the_values_that_validate_takes_from_its_first_minute():
    unseen = read_recording(synthetic_recordings()[2])
    (twin,), _ = paired_twins("study", fit(), unseen)
    (prediction,) = validate(fit(), unseen).predictions
    assert twin.values == prediction.twin.values


def test_a_drive_without_temperatures_has_the_mean_of_the_matched_values(matched):
    drive = Experiment.schedule("0:0.5", duration=60, cells=2)
    (twin,), _ = paired_twins("study", fit(), drive)
    assert ambients([twin]) == [pytest.approx(sum(matched) / 2)]


@pytest.mark.slow
def test_a_sensitivity_of_a_fit_is_that_of_its_twins():
    options = {"draws": 20, "names": ["R_pc", "R_E", "R_Tez", "R_Tfx"]}
    ours = sensitivity(fit(), **options)
    theirs = sensitivity(list(fit().twins.values()), recordings(), **options)
    assert ours.cost.tolist() == theirs.cost.tolist()


def test_a_twin_without_experiments_is_refused():
    with pytest.raises(
        SimulationError, match="sensitivity: experiments: expected one or several, got none"
    ):
        sensitivity(fit().twin)
