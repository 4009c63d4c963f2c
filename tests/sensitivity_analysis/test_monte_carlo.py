"""The analysis on a short recording made by the twin itself."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import pyplot
from scipy.stats import kstest, pearsonr, truncnorm

import jaxtwin as jt
from jaxtwin import Experiment, Twin, sensitivity, simulate
from jaxtwin.errors import ParameterError, RecordingError, SimulationError

NAMES = ["R_E", "R_pc", "R_Tez"]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="module")
def recording(twin: Twin) -> Experiment:
    drive = Experiment.schedule("0:0.8", duration=100, step=2.0, cells=2, channels=("T11", "TAM"))
    run = simulate(twin.with_values({"R_E": 1.5}), drive)
    return Experiment(
        drive.time, drive.duty, channels=run.channels, temperatures=run.temperatures, name="made"
    )


@pytest.fixture(scope="module")
def result(twin: Twin, recording: Experiment) -> jt.sensitivity_analysis.Sensitivity:
    return sensitivity(twin, recording, draws=60, seed=5, names=NAMES)


@pytest.mark.slow
def test_costs_are_the_mean_squared_errors_of_single_runs(
    twin: Twin, recording: Experiment, result: jt.sensitivity_analysis.Sensitivity
):
    assert recording.temperatures is not None
    for draw in (0, 59):
        values = dict(zip(result.names, result.samples[draw], strict=True))
        run = simulate(twin.with_values(values), recording)
        cost = np.mean((run.temperatures - recording.temperatures) ** 2, axis=0)
        np.testing.assert_allclose(result.cost[draw, :2], cost, rtol=1e-5)
        assert result.cost[draw, 2] == pytest.approx(cost.mean(), rel=1e-5)


def test_channels_are_in_the_order_of_the_rig(
    twin: Twin, recording: Experiment, result: jt.sensitivity_analysis.Sensitivity
):
    turned = recording.select(["TAM", "T11"])
    found = sensitivity(twin, turned, draws=60, seed=5, names=NAMES)
    assert found.channels == ("T11", "TAM", "mean")
    np.testing.assert_allclose(found.cost, result.cost)


def test_correlation_is_that_of_costs_and_samples(result: jt.sensitivity_analysis.Sensitivity):
    assert result.channels == ("T11", "TAM", "mean")
    for row in range(3):
        for column in range(len(NAMES)):
            theirs, _ = pearsonr(result.cost[:, row], result.samples[:, column])
            assert result.correlation[row, column] == pytest.approx(theirs, abs=1e-10)
    assert result.ranking("TAM")[0] == NAMES[np.argmax(np.abs(result.correlation[1]))]


def test_the_drive_matters_and_the_same_seed_gives_the_same_numbers(
    twin: Twin, recording: Experiment, result: jt.sensitivity_analysis.Sensitivity
):
    # The recording was made with another R_E, which scales the heat: it must lead.
    assert result.ranking()[0] == "R_E"
    again = sensitivity(twin, recording, draws=60, seed=5, names=NAMES)
    np.testing.assert_array_equal(again.samples, result.samples)
    np.testing.assert_array_equal(again.cost, result.cost)


def test_labels_and_saved_file(result: jt.sensitivity_analysis.Sensitivity, tmp_path):
    import xarray

    data = result.to_xarray()
    assert dict(data.sizes) == {"channel": 3, "parameter": 3, "bound": 2, "draw": 60}
    result.save(tmp_path / "sens.nc")
    with xarray.open_dataset(tmp_path / "sens.nc", engine="scipy") as saved:
        np.testing.assert_array_equal(saved["correlation"].values, result.correlation)


@pytest.mark.parametrize("name", ["sens.csv", "sens.xlsx", "sens"])
def test_an_ending_of_another_format_is_refused(
    result: jt.sensitivity_analysis.Sensitivity, tmp_path, name
):
    with pytest.raises(RecordingError, match=r"ending: expected \.nc.*, got '.*'"):
        result.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_salibs_problem_has_the_distribution_of_the_draws(twin: Twin):
    """SALib takes truncnorm's bounds as lower and upper limit, mean and standard deviation, and
    hands them to SciPy. A wide spread, so that the cut at 0 shows."""
    drive = Experiment.schedule("0:0.8", duration=4, step=2.0, cells=2, channels=("T11",))
    made = replace(drive, temperatures=np.array([[15.0], [16.0], [17.0]]))
    wide = sensitivity(twin, made, draws=2000, spread=0.7, names=["R_E", "R_pc"])
    problem = wide.to_salib()
    assert problem["dists"] == ["truncnorm"] * problem["num_vars"]
    for (low, high, mean, deviation), draws in zip(problem["bounds"], wide.samples.T, strict=True):
        edges = ((low - mean) / deviation, (high - mean) / deviation)
        promised = truncnorm(*edges, loc=mean, scale=deviation)
        assert kstest(draws, promised.cdf).pvalue > 0.01
        np.testing.assert_allclose(promised.ppf([0.0, 1.0]), [0.0, high], atol=1e-12)


@pytest.mark.salib
def test_salib_samples_the_problem_within_its_limits(result: jt.sensitivity_analysis.Sensitivity):
    """Total indices of x1 + x2 / 10 + 0 x3 in relative values: near 1, 0.01 and 0."""
    from SALib.analyze import sobol as analyser
    from SALib.sample import sobol as sampler

    problem = result.to_salib()
    problem["bounds"] = [
        [low / mean, high / mean, 1.0, 3 * deviation / mean]
        for low, high, mean, deviation in problem["bounds"]
    ]
    sample = sampler.sample(problem, 1024, calc_second_order=False, seed=1)
    assert (sample > 0).all()
    assert np.isfinite(sample).all()
    outputs = sample @ np.array([1.0, 0.1, 0.0])
    total = analyser.analyze(problem, outputs, calc_second_order=False, seed=1)["ST"]
    np.testing.assert_allclose(total, [1 / 1.01, 0.01 / 1.01, 0.0], atol=0.02)


def test_the_table_has_a_row_for_each_channel_and_parameter(
    result: jt.sensitivity_analysis.Sensitivity,
):
    table = result.to_dataframe()
    assert table.shape == (9, 6)
    row = table.loc["TAM", "R_pc"]
    place = result.channels.index("TAM"), result.names.index("R_pc")
    assert row["correlation"] == result.correlation[place]
    assert row["rank_correlation"] == result.rank_correlation[place]
    assert (row["rank_lower"], row["rank_upper"]) == tuple(result.rank_interval[place])


def test_a_parameter_is_significant_where_its_interval_excludes_zero(
    result: jt.sensitivity_analysis.Sensitivity,
):
    for ranks, interval in ((False, result.interval), (True, result.rank_interval)):
        low, high = interval[2].T
        signs = np.where(low > 0, 1, np.where(high < 0, -1, 0))
        expected = {name: sign for name, sign in zip(NAMES, signs, strict=True) if sign}
        assert result.significant(ranks=ranks) == expected
    # The heat of the drive, which the recording has less of than the twin.
    assert result.significant(ranks=True)["R_E"] == 1


def test_the_plot_has_a_column_for_each_parameter(result: jt.sensitivity_analysis.Sensitivity):
    axes = result.plot()
    assert len(axes.get_xticks()) == 3
    pyplot.close("all")


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"names": ["R_X"]}, ParameterError, "R_X"),
        ({"names": []}, ParameterError, "none"),
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
