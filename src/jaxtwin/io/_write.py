"""Writes a recording to a file completely or not at all."""

from collections.abc import Sequence
from pathlib import Path

from .._arguments import of_kind, path_of
from .._whole_file import whole_file
from ..errors import RecordingError
from ._csv import write_csv
from ._experiment import EXPERIMENT, Experiment
from ._netcdf import write_netcdf


def write_recording(
    experiment: Experiment, path: str | Path, *, history: Sequence[str] = ()
) -> Path:
    """Writes an experiment as .csv or netCDF (.nc), as the ending of the path says.

    `read_recording` reads back an equal experiment, with every number equal to the last bit; in
    .csv, readings that are codes of sensors become missing. Name
    and group are not kept: a recording has the name of its file, and no group.

    **Arguments:**

    - `experiment`: the experiment to write.
    - `path`: the file. An existing file is replaced.
    - `history`: where the recording is from and what was done to it, a sentence each: lines that
      begin with `#` in a .csv file, the attribute `history` of netCDF. Reading skips it.

    **Returns:**

    The path.

    **Raises:**

    `RecordingError` for another ending, and if the file cannot be written. Then nothing is written,
    and an existing file is unchanged.
    """
    of_kind("write_recording: experiment", experiment, Experiment, EXPERIMENT, RecordingError)
    file = path_of("write_recording: path", path, RecordingError)
    ending = file.suffix.lower()
    if ending not in (".csv", ".nc"):
        raise RecordingError(f"{file}: ending: expected .csv or .nc, got {ending!r}")
    with whole_file(file, RecordingError) as stream:
        if ending == ".nc":
            dataset = experiment.to_xarray()
            if history:
                dataset.attrs["history"] = "\n".join(history)
            write_netcdf(dataset, stream)
        else:
            write_csv(experiment, stream, history)
    return file
