"""What a run tells: its numbers by name, its fit, and itself as a labelled data set."""

from dataclasses import replace

import numpy as np
import pytest
import xarray

from jaxtwin import Experiment, Twin, read_recording
from jaxtwin.errors import RecordingError, SimulationError
from jaxtwin.simulation import Run, fit_percent, rmse

TIME = np.arange(31.0)


@pytest.fixture(scope="module")
def run() -> Run:
    """Against a recording that lies 0.5 K above it in T11 and is one flat line in TBM."""
    twin = Twin("paper-2024")
    duty = np.where(TIME < 10, 0.5, 0.8)[:, None] * np.ones(2)
    inputs = {"channels": ("TBM", "T11"), "ambient": 15.0, "name": "zone-A"}
    exact = twin.simulate(Experiment(TIME, duty, **inputs))
    recorded = np.column_stack([np.full(31, 20.0), exact.channel("T11") + 0.5])
    return twin.simulate(Experiment(TIME, duty, temperatures=recorded, **inputs))


def test_fit_by_hand():
    """100 (1 - |y - yhat| / |y - mean y|): design.md."""
    recorded = np.array([[0.0], [3.0], [6.0], [3.0]])
    simulated = np.array([[1.0], [3.0], [6.0], [2.0]])
    expected = 100 * (1 - np.sqrt(2) / np.sqrt(18))
    np.testing.assert_allclose(fit_percent(recorded, simulated), [expected])
    np.testing.assert_allclose(fit_percent(recorded, recorded), [100.0])
    np.testing.assert_allclose(fit_percent(recorded, np.full((4, 1), 3.0)), [0.0], atol=1e-12)


def test_missing_samples_are_left_out_of_fit_and_rmse():
    recorded = np.array([[0.0, 1.0], [3.0, np.nan], [np.nan, np.nan], [6.0, np.nan], [3.0, 5.0]])
    simulated = np.array([[1.0, 1.0], [3.0, 9.0], [99.0, 9.0], [6.0, 9.0], [2.0, 5.0]])
    expected = [100 * (1 - np.sqrt(2) / np.sqrt(18)), 100.0]
    np.testing.assert_allclose(fit_percent(recorded, simulated), expected)
    assert rmse(recorded, simulated) == pytest.approx(np.sqrt(2 / 6))
    assert np.isnan(fit_percent(np.full((5, 1), np.nan), simulated[:, :1])).all()


@pytest.mark.slow
def test_a_channel_without_samples_has_no_fit(run):
    recorded = np.array(run.experiment.temperatures)
    recorded[:, 0] = np.nan
    gappy = Experiment(
        TIME, run.experiment.duty, channels=run.channels, temperatures=recorded, ambient=15.0
    )
    again = replace(run, experiment=gappy)
    assert again.fit_percent == {"T11": run.fit_percent["T11"]}
    assert again.rmse == pytest.approx(0.5)


def test_fit_of_a_channel_that_never_moves():
    """Nothing to compare with: not a number, however far off the simulation is."""
    flat = np.full((5, 1), 20.0)
    assert np.isnan(fit_percent(flat, flat)).all()
    assert np.isnan(fit_percent(flat, flat + 1)).all()


def test_rmse_by_hand():
    assert rmse(np.array([1.0, 2.0, 3.0]), np.array([1.0, 4.0, 2.0])) == pytest.approx(
        np.sqrt(5 / 3)
    )


def test_fit_and_rmse_of_a_run(run):
    """T11 is off by 0.5 K everywhere."""
    recorded = run.experiment.temperatures
    assert list(run.fit_percent) == ["TBM", "T11"]
    about_mean = np.linalg.norm(recorded[:, 1] - recorded[:, 1].mean())
    assert run.fit_percent["T11"] == pytest.approx(100 * (1 - 0.5 * np.sqrt(31) / about_mean))
    expected = np.sqrt(np.mean((run.temperatures - recorded) ** 2))
    assert run.rmse == pytest.approx(expected)


def test_channels_and_nodes_by_name(run):
    np.testing.assert_array_equal(run.channel("T11"), run.temperatures[:, 1])
    np.testing.assert_allclose(run.node("V11"), run.channel("T11"), atol=1e-9)
    np.testing.assert_array_equal(run.time, TIME)
    with pytest.raises(SimulationError, match=r"channel: expected one of TBM, T11.* got 'T12'"):
        run.channel("T12")
    with pytest.raises(SimulationError, match=r"node: expected one of V11, V12.* got 'V99'"):
        run.node("V99")


@pytest.mark.slow
def test_run_without_a_recording_has_no_fit():
    bare = Twin("paper-2024").simulate(Experiment(TIME, np.zeros((31, 2))))
    for measure in ("fit_percent", "rmse"):
        with pytest.raises(SimulationError, match="expected recorded temperatures"):
            getattr(bare, measure)
    assert "recorded" not in bare.to_xarray()
    assert "ambient" not in bare.to_xarray()


def test_labelled_data_set(run):
    """design.md: dims (time, channel), degC; cells named as recordings name them."""
    data = run.to_xarray()
    assert data["temperature"].dims == ("time", "channel")
    assert data["temperature"].attrs["units"] == "degC"
    np.testing.assert_array_equal(data["temperature"].sel(channel="T11"), run.channel("T11"))
    np.testing.assert_array_equal(data["recorded"], run.experiment.temperatures)
    np.testing.assert_array_equal(data["state"].sel(node="P1.TC"), run.node("P1.TC"))
    np.testing.assert_array_equal(data["ambient"], np.full(31, 15.0))
    np.testing.assert_array_equal(data["cell"], run.experiment.to_xarray()["cell"])
    assert data.attrs == {"rig": "paper-2024", "experiment": "zone-A"}


def test_saved_data_set_reads_back_the_same(run, tmp_path):
    run.save(tmp_path / "run.nc")
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"]
    with xarray.open_dataset(tmp_path / "run.nc", engine="scipy") as data:
        xarray.testing.assert_identical(data.load(), run.to_xarray())


def test_a_table_of_what_the_camera_reads_is_a_recording(run, tmp_path):
    """With the ending .csv; every number reads back the same to its last bit."""
    run.save(tmp_path / "run.csv")
    table = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(table.temperatures, run.temperatures)
    np.testing.assert_array_equal(table.duty, run.experiment.duty)
    assert (table.channels, table.ambient) == (run.channels, run.experiment.ambient)


@pytest.mark.parametrize("name", ["run.xlsx", "run", "run.nc.gz"])
def test_an_ending_of_another_format_is_refused(run, tmp_path, name):
    with pytest.raises(RecordingError, match=r"ending: expected \.nc or \.csv.*, got '.*'"):
        run.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_file_that_cannot_be_written_is_an_error(run, tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere.*run\.nc: cannot be written"):
        run.save(tmp_path / "nowhere" / "run.nc")


def test_run_prints_what_it_is(run):
    low, high = run.temperatures.min(), run.temperatures.max()
    text = f"<Run of paper-2024: 31 times, 2 channels, {low:.2f} to {high:.2f} degC>"
    assert repr(run) == text


@pytest.mark.slow
def test_a_run_becomes_a_recording_with_the_noise_of_its_rig():
    twin = Twin("dual-cell")
    run = twin.simulate(Experiment.schedule("0:0.5", duration=400, cells=2, ambient=17))
    recording = run.to_recording(seed=3, name="trial")
    assert (recording.name, recording.ambient, recording.channels) == ("trial", 17, run.channels)
    assert recording.temperatures is not None
    noise = recording.temperatures - run.temperatures
    assert noise.std() == pytest.approx(twin.rig.noise, rel=0.02)
    assert run.to_recording(seed=3) == recording
    assert run.to_recording(seed=4) != recording
    np.testing.assert_array_equal(run.to_recording(noise=0).temperatures, run.temperatures)
    with pytest.raises(
        SimulationError, match="noise: expected a number of at least 0, in K, got -1"
    ):
        run.to_recording(noise=-1)
