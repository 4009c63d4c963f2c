"""The analysis on a short recording made by the twin itself."""

import numpy as np
import pytest
from scipy.stats import pearsonr

import jaxtwin as jt
from jaxtwin import (
    Experiment,
    ParameterError,
    RecordingError,
    SimulationError,
    Twin,
    sensitivity,
    simulate,
)

NAMES = ["R_E", "R_pc", "R_Tez"]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="module")
def recording(twin: Twin) -> Experiment:
    drive = Experiment.schedule("0:0.8", duration=100, step=2.0, cells=2, channels=("T11", "TAM"))
    run = simulate(twin.with_parameters({"R_E": 1.5}), drive)
    return Experiment(
        drive.time, drive.duty, channels=run.channels, temperatures=run.temperatures, name="made"
    )


@pytest.fixture(scope="module")
def result(twin: Twin, recording: Experiment) -> jt.Sensitivity:
    return sensitivity(twin, recording, draws=60, seed=5, parameters=NAMES)


def test_costs_are_the_mean_squared_errors_of_single_runs(
    twin: Twin, recording: Experiment, result: jt.Sensitivity
):
    assert recording.temperatures is not None
    for draw in (0, 59):
        values = dict(zip(result.names, result.samples[draw], strict=True))
        run = simulate(twin.with_parameters(values), recording)
        cost = np.mean((run.temperatures - recording.temperatures) ** 2, axis=0)
        np.testing.assert_allclose(result.cost[draw, :2], cost, rtol=1e-8)
        assert result.cost[draw, 2] == pytest.approx(cost.mean(), rel=1e-8)


def test_correlation_is_that_of_costs_and_samples(result: jt.Sensitivity):
    assert result.channels == ("T11", "TAM", "mean")
    for row in range(3):
        for column in range(len(NAMES)):
            theirs, _ = pearsonr(result.cost[:, row], result.samples[:, column])
            assert result.correlation[row, column] == pytest.approx(theirs, abs=1e-10)
    assert result.ranking("TAM")[0] == NAMES[np.argmax(np.abs(result.correlation[1]))]


def test_the_drive_matters_and_the_same_seed_gives_the_same_numbers(
    twin: Twin, recording: Experiment, result: jt.Sensitivity
):
    # The recording was made with another R_E, which scales the heat: it must lead.
    assert result.ranking()[0] == "R_E"
    again = sensitivity(twin, recording, draws=60, seed=5, parameters=NAMES)
    np.testing.assert_array_equal(again.samples, result.samples)
    np.testing.assert_array_equal(again.cost, result.cost)


def test_labels_and_saved_file(result: jt.Sensitivity, tmp_path):
    import xarray

    data = result.to_xarray()
    assert dict(data.sizes) == {"channel": 3, "parameter": 3, "bound": 2, "draw": 60}
    result.save(tmp_path / "sens.nc")
    with xarray.open_dataset(tmp_path / "sens.nc", engine="scipy") as saved:
        np.testing.assert_array_equal(saved["correlation"].values, result.correlation)


@pytest.mark.parametrize("name", ["sens.csv", "sens.xlsx", "sens"])
def test_an_ending_of_another_format_is_refused(result: jt.Sensitivity, tmp_path, name):
    with pytest.raises(RecordingError, match=r"ending: found '.*', allowed is \.nc"):
        result.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_sample_of_salib_fits_its_problem(result: jt.Sensitivity):
    problem = result.to_salib()
    assert problem["num_vars"] == len(problem["names"]) == len(problem["bounds"]) == 3
    np.testing.assert_allclose(problem["bounds"][0], [1.9675, 0.25 * 1.9675], rtol=1e-4)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"parameters": ["R_X"]}, ParameterError, "R_X"),
        ({"parameters": []}, ParameterError, "none"),
        ({"draws": 2}, SimulationError, "at least 3"),
        ({"spread": 1.5}, SimulationError, "spread"),
    ],
)
def test_bad_requests_say_what_is_allowed(twin, recording, options, error, words):
    with pytest.raises(error, match=words):
        sensitivity(twin, recording, **options)


def test_twins_and_experiments_must_pair_up(twin: Twin, recording: Experiment):
    with pytest.raises(SimulationError, match="2 twins for 1"):
        sensitivity([twin, twin], recording)
