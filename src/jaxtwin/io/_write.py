"""Writing a recording to a file, so that it is there as a whole or not at all."""

import os
import uuid
from pathlib import Path

from .._errors import RecordingError
from ._csv import format_csv
from ._experiment import Experiment
from ._netcdf import format_netcdf
from ._read import check_no_gap


def write_recording(experiment: Experiment, path: str | Path) -> Path:
    """Writes an experiment as .csv or netCDF (.nc), as the ending of the path says.

    `read_recording` reads back an equal experiment, every number the same to its last bit. Only
    the name is not kept: it is the file's.

    **Arguments:**

    - `experiment`: what to write.
    - `path`: the file; one that is there is replaced.

    **Returns:**

    The path.

    **Raises:**

    `RecordingError` for another ending, for recorded temperatures with a gap, which would be
    refused on reading, and where the file cannot be written. Then nothing is written, and a file
    that was there stays as it was.
    """
    file = Path(path)
    ending = file.suffix.lower()
    if ending not in (".csv", ".nc"):
        raise RecordingError(f"{file}: recordings are written as .csv or .nc, not as {ending!r}")
    try:
        check_no_gap(experiment)
    except RecordingError as error:
        raise RecordingError(f"{file}: not written: {error}") from None
    content = format_netcdf(experiment) if ending == ".nc" else format_csv(experiment).encode()
    # Beside the file, so that the last step is a rename on one disk: it happens or it does not.
    part = file.with_name(f".{file.name}.{uuid.uuid4().hex}.part")
    try:
        with part.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(file)
    except OSError as error:
        raise RecordingError(f"{file}: cannot be written: {error.strerror}") from None
    finally:
        part.unlink(missing_ok=True)
    return file
