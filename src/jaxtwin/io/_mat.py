"""The authors' MATLAB files: a matrix `simout` with a row for each second.

Columns of the two-cell rig: 1 an unused controller output, 2 a copy of 7, 3 time, 4 set point, 5
and 6 the upper zones (second, first), 7 the centre tap, 8 and 9 the lower zones (second, first), 10
and 11 the PWM counts of the cells. Columns of the one-cell rig: PWM counts, temperature, time, set
point. Times in s, temperatures in degC. The files also hold variables of the controller, including
objects that only MATLAB can read; only `simout` is read.
"""

import re

import numpy as np
from jaxtyping import Float

from .._errors import RecordingError
from ._checks import duty_from_counts
from ._experiment import Experiment
from ._matlab5 import read_matrix

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
        channels=channels,
        temperatures=temperatures,
        name=name,
    )


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
        found = {letter.upper() for letter in re.findall(pattern, name, re.IGNORECASE)}
        if len(found) != 1:
            raise RecordingError(
                "zone: expected a file name with the zone of the plate ('...SecA...'), got none; "
                "pass zone='A', 'B' or 'C'"
            )
        return found.pop()
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
