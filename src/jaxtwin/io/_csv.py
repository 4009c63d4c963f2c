"""Recordings as text: a line of column names with units, then a line for each sample.

`time_s,duty_P1,duty_P2,T11_degC,T12_degC,ambient_degC`

Numbers are written with as many digits as are necessary to read the same number back. A missing
sample is an empty field. `_delimited` reads the variants that other programs write.
"""

import csv
import io
from collections.abc import Sequence
from typing import IO

import numpy as np

from ..errors import RecordingError
from ._checks import WrongSampleError
from ._column_meaning import Choices
from ._delimited import read_columns
from ._experiment import Experiment
from ._recorded_columns import EXPECTED, RecordedDrive, experiment_of_columns, held

# The number of rows that are written at a time.
ROWS = 10_000


def parse_csv(
    content: bytes, *, name: str, drive: RecordedDrive, choices: Choices, header: int | None = None
) -> Experiment:
    """The experiment in a .csv file; for the arguments see `read_recording`."""
    columns, _ = read_columns(content, EXPECTED, choices, header)
    try:
        return experiment_of_columns(columns, name, drive)
    except WrongSampleError as error:
        lines = held(columns)[0][0].lines
        raise RecordingError(f"line {lines[error.sample]}: {error}") from None


def write_csv(experiment: Experiment, stream: IO[bytes], history: Sequence[str] = ()) -> None:
    """Writes the experiment as a .csv file, which `parse_csv` reads back exactly; some rows at a
    time, since text takes ten times the memory of numbers. `history` are notes above the titles."""
    samples = len(experiment.time)
    cells = [f"duty_{name}" for name in experiment.cell_names]
    channels = [f"{channel}_degC" for channel in experiment.channels]
    ambient = [] if experiment.ambient is None else ["ambient_degC"]
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    # A line break would end the note.
    text.writelines(f"# {' '.join(line.split())}\n" for line in history)
    inputs = experiment.inputs
    writer.writerow(["time_s", *cells, *channels, *ambient, *(f"input_{name}" for name in inputs)])
    room = np.broadcast_to(0.0 if experiment.ambient is None else experiment.ambient, samples)
    for first in range(0, samples, ROWS):
        part = slice(first, first + ROWS)
        recorded = experiment.temperatures
        readings = [[""] * len(channels)] * len(experiment.time[part])
        if recorded is not None:
            rows = recorded[part].tolist()
            readings = [["" if value != value else value for value in row] for row in rows]
        columns = experiment.time[part].tolist(), experiment.duty[part].tolist(), readings
        rooms = room[part, None].tolist() if ambient else [[]] * len(experiment.time[part])
        others = [values[part].tolist() for values in inputs.values()]
        states = zip(*others, strict=True) if others else [()] * len(experiment.time[part])
        for time, duty, row, degC, levels in zip(*columns, rooms, states, strict=True):
            writer.writerow([time, *duty, *row, *degC, *levels])
    text.flush()
    text.detach()
