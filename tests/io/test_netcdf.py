"""Recordings as netCDF, version 3 and 4."""

import sys

import numpy as np
import pytest
import xarray

from jaxtwin.errors import RecordingError
from jaxtwin.io import read_recording


@pytest.fixture(params=["scipy", "h5netcdf"])
def save(request, tmp_path):
    """Saves a data set as netCDF 3 or netCDF 4 and gives its path."""

    def save(data: xarray.Dataset):
        path = tmp_path / "run.nc"
        data.to_netcdf(path, engine=request.param)
        return path

    return save


def test_both_versions_give_back_the_experiment(save, experiment):
    assert read_recording(save(experiment.to_xarray())) == experiment


def test_the_order_of_dimensions_does_not_matter(save, experiment):
    data = experiment.to_xarray().transpose("channel", "cell", "time")
    assert read_recording(save(data)) == experiment


def test_kelvin_is_converted(save, experiment):
    data = experiment.to_xarray()
    for name in ("temperature", "ambient"):
        data[name] = (data[name] + 273.15).assign_attrs(units="K")
    again = read_recording(save(data))
    assert again.temperatures is not None
    assert again.ambient is not None
    np.testing.assert_allclose(again.temperatures, experiment.temperatures, atol=1e-12)
    np.testing.assert_allclose(again.ambient, experiment.ambient, atol=1e-12)


def test_one_cell_and_one_channel_may_stand_without_their_dimensions(save, experiment):
    data = experiment.to_xarray().isel(cell=0, channel=2)
    again = read_recording(save(data))
    assert again.channels == ("TAM",)
    np.testing.assert_array_equal(again.duty, experiment.duty[:, :1])
    np.testing.assert_array_equal(again.temperatures, experiment.temperatures[:, 2:])


@pytest.mark.parametrize("fill", [np.nan, -9999.0])
def test_a_fill_value_is_a_missing_sample(save, experiment, fill):
    data = experiment.to_xarray().copy(deep=True)
    data["temperature"][3, 1] = data["ambient"][5] = np.nan
    data["temperature"].encoding["_FillValue"] = data["ambient"].encoding["_FillValue"] = fill
    again = read_recording(save(data))
    assert again.temperatures is not None
    expected = np.array(experiment.temperatures)
    expected[3, 1] = np.nan
    np.testing.assert_array_equal(again.temperatures, expected)
    assert isinstance(again.ambient, np.ndarray)
    assert again.ambient[5] == pytest.approx((again.ambient[4] + again.ambient[6]) / 2)


@pytest.mark.parametrize("name", ["time", "duty"])
def test_time_and_duty_must_be_complete(save, experiment, name):
    data = experiment.to_xarray().copy(deep=True)
    if name == "time":
        data = data.assign_coords(time=("time", np.r_[np.nan, 1:40], {"units": "s"}))
    else:
        data["duty"][0, 0] = np.nan
    with pytest.raises(RecordingError, match=rf"run\.nc: {name}.* got nan at sample 0"):
        read_recording(save(data))


def test_packed_numbers_and_integer_times_are_unpacked(save, experiment):
    """Instruments store tenths of a degree as integers with a scale factor."""
    data = experiment.to_xarray().drop_vars("ambient")
    data = data.assign_coords(time=("time", np.arange(40, dtype="i4"), {"units": "s"}))
    data["temperature"].encoding = {"dtype": "i2", "scale_factor": 0.1, "_FillValue": -9999}
    again = read_recording(save(data))
    np.testing.assert_array_equal(again.time, np.arange(40))
    assert again.temperatures is not None
    np.testing.assert_allclose(again.temperatures, experiment.temperatures, atol=0.051)


def test_other_variables_are_left_alone(save, experiment):
    data = experiment.to_xarray().assign(note=("line", ["a", "b"]), states=("time", np.ones(40)))
    assert read_recording(save(data)) == experiment


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.drop_vars("duty"), "'time' and 'duty', got no 'duty'"),
        (lambda data: data.drop_vars("time"), "got no 'time'"),
        (lambda data: data.drop_vars("channel"), "and 0 channels"),
        (
            lambda data: data.rename(cell="module"),
            r"'duty': expected the dimensions .* got \('time', 'module'\)",
        ),
        (lambda data: data.assign_coords(cell=["P1", "P1"]), "each once, got P1, P1"),
        (
            lambda data: data.assign(ambient=data.duty),
            "variable 'ambient': expected the dimensions",
        ),
        (
            lambda data: data.assign_coords(channel=["a", "b", "a"]),
            "each name once, got a more than",
        ),
        (lambda data: data.where(data.time < 5), "duty of P1: .* got nan at sample 5"),
        (lambda data: data.isel(time=[1, 0]), "time: expected increasing times"),
        (lambda data: data.isel(time=[1]), "empty: expected at least 2 samples, got 1"),
        (
            lambda data: data.assign(duty=data.duty.astype(str)),
            "'duty': expected the unit .* got ''|expected real",
        ),
    ],
)
def test_what_is_wrong_is_named(save, experiment, change, said):
    with xarray.set_options(keep_attrs=True):
        data = change(experiment.to_xarray())
    with pytest.raises(RecordingError, match=said):
        read_recording(save(data))


@pytest.mark.parametrize(
    ("variable", "unit", "expected"),
    [
        ("time", "ms", "'s'"),
        ("duty", "percent", "'1'"),
        ("temperature", "degF", "'degC'"),
        ("temperature", "", "'degC'"),
        ("ambient", "mK", "'degC'"),
    ],
)
def test_units_are_checked(save, experiment, variable, unit, expected):
    data = experiment.to_xarray()
    data[variable].attrs["units"] = unit
    said = f"variable '{variable}': expected the unit {expected}, got '{unit}'"
    with pytest.raises(RecordingError, match=said):
        read_recording(save(data))


def test_netcdf_4_without_its_library_says_what_to_install(experiment, tmp_path, monkeypatch):
    path = tmp_path / "run.nc"
    experiment.to_xarray().to_netcdf(path, engine="h5netcdf")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match=r"pip install 'jaxtwin\[storage\]'"):
        read_recording(path)


def test_another_file_with_this_ending_is_no_netcdf(tmp_path):
    path = tmp_path / "run.nc"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(RecordingError, match=r"expected a netCDF file, got .* b'nothing '"):
        read_recording(path)
