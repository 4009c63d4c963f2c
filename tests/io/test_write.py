"""Writing recordings: the whole file or nothing."""

from pathlib import Path

import numpy as np
import pytest

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment, read_recording, write_recording


@pytest.mark.parametrize("name", ["run.mat", "run", "run.txt"])
def test_only_the_two_formats_that_it_knows(tmp_path, experiment, name):
    with pytest.raises(RecordingError, match=rf"{name}: ending: expected \.csv or \.nc"):
        write_recording(experiment, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_recording_with_a_gap_is_read_back(tmp_path):
    experiment = Experiment([0, 1, 2, 9], np.zeros(4), channels=["T"], temperatures=np.zeros(4))
    again = read_recording(write_recording(experiment, tmp_path / "run.csv"))
    assert again == experiment
    assert again.gaps.tolist() == [[2, 9]]


def test_a_file_that_is_there_is_replaced(tmp_path, experiment):
    path = tmp_path / "run.nc"
    path.write_text("something else")
    assert read_recording(write_recording(experiment, path)) == experiment


@pytest.mark.parametrize("name", ["run.csv", "run.nc"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path, experiment, monkeypatch, name
):
    """The disk is full when the last bytes are to go out."""

    def full_disk(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    path = write_recording(experiment, tmp_path / name)
    before = path.read_bytes()
    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(RecordingError, match=f"{name}: cannot be written: No space left"):
        write_recording(experiment.between(0, 10), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there(tmp_path, experiment):
    with pytest.raises(RecordingError, match="cannot be written: No such file or directory"):
        write_recording(experiment, tmp_path / "no" / "run.csv")


@pytest.mark.parametrize("name", ["run.mat", "run.csv", "run.nc", "run"])
def test_reading_what_is_not_there_or_empty(tmp_path, name):
    path: Path = tmp_path / name
    with pytest.raises(RecordingError, match=f"{name}: cannot be read: No such file"):
        read_recording(path)
    path.touch()
    with pytest.raises(RecordingError, match=rf"{name}: expected .* got an empty file \(0 bytes\)"):
        read_recording(path)
    with pytest.raises(RecordingError, match="cannot be read: Is a directory"):
        read_recording(tmp_path)
