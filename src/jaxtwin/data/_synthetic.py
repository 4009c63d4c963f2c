"""Synthetic recordings of a twin with known parameters, for use without the authors' recordings.

`python -m jaxtwin.data._make_synthetic` makes them again.
"""

from pathlib import Path

from .._data_folder import data_folder

# Zones A, B and C of the two-cell plate, as the paper's recordings have them.
SYNTHETIC = ("synthetic-A", "synthetic-B", "synthetic-C")


def synthetic_recordings() -> tuple[Path, ...]:
    """The files of the synthetic recordings, for `read_recording`, in the order of the zones."""
    return tuple(_file(f"{name}.csv") for name in SYNTHETIC)


def synthetic_truth() -> Path:
    """The file of the parameters with which they were made, for `read_parameters`.

    Values that differ between the recordings (ambient and start temperature) are listed under the
    name of the recording.
    """
    return _file("synthetic-truth.toml")


def _file(name: str) -> Path:
    return data_folder() / "recordings" / name
