"""Damaged files: a `RecordingError` or, where the damage makes another valid file, an experiment.

Never another exception, never a crash, and nothing written.
"""

import io
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, read_recording, write_recording

FORMATS = ["packed SecA.mat", "plain SecA.mat", "run.csv", "run.nc"]


@pytest.fixture(scope="module")
def files(tmp_path_factory, experiment, two_cell_simout) -> dict[str, bytes]:
    """Good files by name.

    `netCDF 4.nc` is only cut off here: its reader, the HDF5 library, can loop for ever on bytes
    that were overwritten.
    """
    folder = tmp_path_factory.mktemp("good")
    content = {}
    for name, compressed in {"packed SecA.mat": True, "plain SecA.mat": False}.items():
        stream = io.BytesIO()
        variables = {"alpha": 1.0, "simout": two_cell_simout, "tout": np.arange(40)}
        scipy.io.savemat(stream, variables, do_compression=compressed)
        content[name] = stream.getvalue()
    for name in ("run.csv", "run.nc"):
        content[name] = write_recording(experiment, folder / name).read_bytes()
    experiment.to_xarray().to_netcdf(folder / "netCDF 4.nc", engine="h5netcdf")
    return content | {"netCDF 4.nc": (folder / "netCDF 4.nc").read_bytes()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """One folder for all the examples of this module."""
    return tmp_path_factory.mktemp("damaged")


def read_or_error(folder: Path, name: str, content: bytes) -> Experiment | str:
    """The experiment or the error's text, which names the file; the folder stays as it is."""
    path = folder / name
    path.write_bytes(content)
    try:
        result = read_recording(path)
    except RecordingError as error:
        result = str(error)
    if isinstance(result, str):
        assert result.startswith(f"{path}: ")
        assert "\n" not in result
    assert path.read_bytes() == content
    path.unlink()
    assert list(folder.iterdir()) == []
    return result


@pytest.mark.parametrize("name", [*FORMATS, "netCDF 4.nc"])
def test_undamaged_they_can_be_read(folder, files, name):
    """Otherwise the other tests here would show nothing."""
    assert isinstance(read_or_error(folder, name, files[name]), Experiment)


@pytest.mark.parametrize("name", [*FORMATS, "netCDF 4.nc"])
@given(data=st.data())
def test_a_file_cut_off_anywhere_is_refused(folder, files, name, data):
    content = files[name][: data.draw(st.integers(0, len(files[name]) - 1))]
    result = read_or_error(folder, name, content)
    # A text that ends early, at the end of a number, is a shorter recording.
    assert isinstance(result, str) or name == "run.csv" or same(result, files, folder, name)


@pytest.mark.parametrize("name", FORMATS)
@given(
    damage=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=1, max_size=8)),
        min_size=1,
        max_size=6,
    )
)
def test_a_file_with_bytes_overwritten_is_read_or_refused(folder, files, name, damage):
    content = bytearray(files[name])
    for place, new in damage:
        start = int(place * len(content))
        content[start : start + len(new)] = new
    read_or_error(folder, name, bytes(content))


@pytest.mark.parametrize("name", FORMATS)
@given(place=st.floats(0, 1), new=st.binary(min_size=1, max_size=40))
def test_a_file_with_bytes_inserted_is_read_or_refused(folder, files, name, place, new):
    content = files[name]
    start = int(place * len(content))
    read_or_error(folder, name, content[:start] + new + content[start:])


@pytest.mark.parametrize("name", ["SecA.mat", "run.csv", "run.nc", "run"])
@given(content=st.binary() | st.text().map(str.encode))
def test_a_file_of_any_bytes_is_refused(folder, name, content):
    assert isinstance(read_or_error(folder, name, content), str)


@given(content=st.binary(max_size=400))
def test_any_bytes_after_the_header_of_a_matlab_file_are_refused(folder, files, content):
    result = read_or_error(folder, "SecA.mat", files["plain SecA.mat"][:128] + content)
    assert isinstance(result, str)


def same(result: Experiment | str, files: dict[str, bytes], folder: Path, name: str) -> bool:
    """Whether what was read is what the undamaged file holds."""
    return result == read_or_error(folder, name, files[name])
