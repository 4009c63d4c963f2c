"""The authors' MATLAB files: a matrix `simout` with a row for each second.

Columns of the two-cell rig: 1 an unused controller output, 2 a copy of 7, 3 time, 4 set point, 5
and 6 the upper zones (second, first), 7 the centre tap, 8 and 9 the lower zones (second, first), 10
and 11 the PWM counts of the cells. Columns of the one-cell rig: PWM counts, temperature, time, set
point. Times in s, temperatures in degC. The files also hold variables of the controller, including
objects that only MATLAB can read; only `simout` is read.

Other files hold vectors of one length, and matrices with as many rows: their variables are columns,
`t`, `u`, `y`, and those of a matrix `data_1`, `data_2`, ... Files of MATLAB 7.3 are HDF5, and
fields of a structure are `log.t`.
"""

import io
import re
from collections import Counter
from contextlib import suppress

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError
from ._checks import duty_from_counts
from ._experiment import Experiment
from ._matlab5 import is_matlab5, matrix_names, read_matrix
from ._table_files import csv_of_rows

TWO_CELL_COLUMNS = 11
ONE_CELL_COLUMNS = 4
ZONES = {
    "A": ("T12", "T11", "TAM", "T22", "T21"),
    "B": ("T14", "T13", "TBM", "T24", "T23"),
    "C": ("T16", "T15", "TCM", "T26", "T25"),
}
ONE_CELL_CHANNELS = ("T",)


def parse_mat(
    content: bytes, *, name: str, zone: str | None, counts: int, polarity: int
) -> Experiment:
    """The experiment in a MATLAB 5 file; for the arguments see `read_recording`."""
    simout = _simout(content)
    if simout.shape[1] == ONE_CELL_COLUMNS:
        if zone is not None:
            raise RecordingError(
                "zone: expected none for a recording of one cell ('simout' has 4 columns), got "
                f"{zone!r}"
            )
        time, pwm, temperatures = simout[:, 2], simout[:, :1], simout[:, 1:2]
        channels = ONE_CELL_CHANNELS
    else:
        time, pwm, temperatures = simout[:, 2], simout[:, 9:11], simout[:, 4:9]
        channels = ZONES[_zone(name, zone)]
    _check_range(temperatures)
    return Experiment(
        time,
        duty_from_counts(pwm, counts, polarity),
        cells=[f"P{number + 1}" for number in range(pwm.shape[1])],
        channels=channels,
        temperatures=temperatures,
        name=name,
    )


def is_of_the_authors(content: bytes) -> bool:
    """Whether a MATLAB 5 file has their variable."""
    return is_matlab5(content) and "simout" in matrix_names(content)


def csv_of_mat(content: bytes) -> bytes:
    """The variables of a MATLAB file as the columns of a .csv file.

    **Raises:** `RecordingError` if the file is damaged, or no variables have a length in common.
    """
    matrices = _matrices_of_hdf5(content) if not is_matlab5(content) else _matrices(content)
    vectors = {
        name: matrix.reshape(-1, 1) if 1 in matrix.shape or matrix.ndim == 1 else matrix
        for name, matrix in matrices.items()
        if matrix.size > 1 and matrix.ndim <= 2
    }
    lengths = Counter(len(vector) for vector in vectors.values())
    if not lengths:
        known = ", ".join(matrices) or "none"
        raise RecordingError(f"expected variables that are vectors of numbers, got {known}")
    length = max(lengths, key=lambda one: (lengths[one], one))
    columns: dict[str, list[float]] = {}
    for name, vector in vectors.items():
        if len(vector) == length:
            names = (
                [name]
                if vector.shape[1] == 1
                else [f"{name}_{number + 1}" for number in range(vector.shape[1])]
            )
            columns |= dict(zip(names, vector.T.tolist(), strict=True))
    return csv_of_rows([[*columns], *zip(*columns.values(), strict=True)])


def _matrices(content: bytes) -> dict[str, Float[np.ndarray, "..."]]:
    matrices = {}
    for name in matrix_names(content):
        with suppress(RecordingError):  # text, structures, cells
            matrices[name] = read_matrix(content, name, logical=True)
    return matrices


def _matrices_of_hdf5(content: bytes) -> dict[str, Float[np.ndarray, "..."]]:
    """The numeric variables of a file of MATLAB 7.3, whose matrices are transposed in HDF5."""
    try:
        import h5py
    except ImportError:
        raise RecordingError(
            "is a file of MATLAB 7.3 (HDF5); reading it needs pip install 'jaxtwin[storage]', or "
            "save it in MATLAB with '-v7'"
        ) from None
    matrices: dict[str, Float[np.ndarray, ...]] = {}

    def add(name: str, item: object) -> None:
        is_number = isinstance(item, h5py.Dataset) and item.dtype.kind in "iufb"
        if is_number and not name.startswith("#"):
            matrices[name.replace("/", ".")] = np.asarray(item, np.float64).T

    try:
        with h5py.File(io.BytesIO(content)) as file:
            file.visititems(add)
    except Exception as error:  # the library raises whatever the damaged bytes lead to
        raise RecordingError(f"is a damaged file of MATLAB 7.3 ({type(error).__name__})") from None
    return matrices


def _simout(content: bytes) -> Float[np.ndarray, "times columns"]:
    simout = read_matrix(content, "simout")
    if simout.ndim != 2 or simout.shape[1] not in (TWO_CELL_COLUMNS, ONE_CELL_COLUMNS):
        raise RecordingError(
            f"variable 'simout': expected {TWO_CELL_COLUMNS} columns (two cells) or "
            f"{ONE_CELL_COLUMNS} (one cell), with a row for each time, got shape {simout.shape}"
        )
    return simout


def _zone(name: str, zone: str | None) -> str:
    if zone is None:
        pattern = r"(?:sec|section|zone)[ _-]?([abc])(?![a-z])"
        result = {letter.upper() for letter in re.findall(pattern, name, re.IGNORECASE)}
        if len(result) != 1:
            raise RecordingError(
                "zone: expected a file name with the zone of the plate ('...SecA...'), got none; "
                "pass zone='A', 'B' or 'C'"
            )
        return result.pop()
    if zone.upper() not in ZONES:
        raise RecordingError(f"zone: expected 'A', 'B' or 'C', got {zone!r}")
    return zone.upper()


def _check_range(temperatures: np.ndarray) -> None:
    """Refuses temperatures that the camera cannot read, such as those of a file in kelvin or with
    other columns."""
    low, high = -60.0, 250.0
    wrong = np.argwhere((temperatures < low) | (temperatures > high))
    if wrong.size:
        k, column = wrong[0]
        raise RecordingError(
            f"temperature: expected {low:g} to {high:g} degC, got {temperatures[k, column]:g} "
            f"degC in row {k + 1} of 'simout'"
        )
