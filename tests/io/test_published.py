"""The authors' own recordings, where they are on this machine.

What is expected of them stands in the paper (Fig. 6) and in means taken from the files themselves
with another reader.
"""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from jaxtwin.errors import RecordingError
from jaxtwin.io import SINGLE_CELL, TWO_CELL, PublishedRecording, find_recordings, read_recording

# degC: mean of the first 5 s, of 450 to 499 s (duty 128/255) and of 951 to 1000 s (duty 200/255)
PLATEAUS = {
    "T11": (15.29, 35.77, 44.79),
    "T12": (15.70, 38.14, 48.70),
    "T13": (17.80, 34.30, 41.91),
    "T14": (17.84, 33.76, 40.33),
    "T15": (16.13, 31.43, 38.48),
    "T16": (16.10, 27.47, 32.34),
    "T21": (15.11, 33.75, 41.92),
    "T22": (15.57, 35.89, 45.44),
    "T23": (17.50, 34.22, 41.74),
    "T24": (17.74, 32.31, 38.40),
    "T25": (16.10, 30.91, 37.97),
    "T26": (16.10, 27.09, 31.86),
    "TAM": (15.27, 38.94, 50.11),
    "TBM": (17.51, 33.95, 41.00),
    "TCM": (15.98, 29.97, 36.50),
}


def found(recordings: tuple[PublishedRecording, ...]) -> dict[str, tuple[Path, str]]:
    """Path and checksum of those that are on this machine."""
    paths = {}
    for recording in recordings:
        try:
            (path,) = find_recordings(names=[recording.name])
        except RecordingError:
            continue
        paths[recording.name] = (path, recording.sha256)
    return paths


TWO_CELL_FOUND = found(TWO_CELL)
SINGLE_CELL_FOUND = found(SINGLE_CELL)


def test_the_channels_of_the_three_zones_are_those_of_the_paper():
    """T11 to T16, T21 to T26 and three taps: the 15 channels of Fig. 15, each in one zone."""
    from jaxtwin.io._mat import ZONES

    names = [name for channels in ZONES.values() for name in channels]
    assert sorted(names) == sorted(PLATEAUS)


# Defined only where there is something to check: a test without a case counts as skipped.
if TWO_CELL_FOUND:

    @pytest.mark.parametrize("name", TWO_CELL_FOUND)
    def test_two_cell_recording(name):
        path, sha256 = TWO_CELL_FOUND[name]
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sha256
        experiment = read_recording(path)
        np.testing.assert_array_equal(experiment.time, np.arange(1001))
        np.testing.assert_array_equal(experiment.switch_times, [500])
        np.testing.assert_array_equal(experiment.duty[[0, 499]], np.full((2, 2), 128 / 255))
        np.testing.assert_array_equal(experiment.duty[[500, -1]], np.full((2, 2), 200 / 255))
        assert experiment.temperatures is not None
        for channel, column in zip(experiment.channels, experiment.temperatures.T, strict=True):
            means = [column[:5].mean(), column[450:500].mean(), column[-50:].mean()]
            np.testing.assert_allclose(means, PLATEAUS[channel], atol=0.0051)


if SINGLE_CELL_FOUND:

    @pytest.mark.parametrize("name", SINGLE_CELL_FOUND)
    def test_single_cell_recording(name):
        path, sha256 = SINGLE_CELL_FOUND[name]
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sha256
        experiment = read_recording(path)
        np.testing.assert_array_equal(experiment.time, np.arange(3601))
        assert (experiment.duty.min(), experiment.duty.max()) == (-1, 1)
        assert experiment.channels == ("T",)
        assert experiment.temperatures is not None
        # set points from 23 to 90 degC; full drive heats from the start on
        assert 10 < experiment.temperatures.min() < 17
        assert 85 < experiment.temperatures.max() < 91
