"""Writes a recording to a file completely or not at all, also a copy of one that still grows."""

import hashlib
import os
import sqlite3
import uuid
from collections.abc import Sequence
from pathlib import Path

from .._arguments import of_kind, path_of
from .._whole_file import whole_file
from ..errors import RecordingError
from ._csv import write_csv
from ._experiment import EXPERIMENT, Experiment
from ._netcdf import write_netcdf
from ._session import Session


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


# Copies a recording while it grows, with a checksum in a second file.

PAGES = 1000  # at a time: the recorder gets its turn in between


def backup_session(file: str | Path, copy: str | Path) -> str:
    """Copies a recording as it is at one moment, also while it is recorded into.

    A plain copy of the file misses records that are still in its journal. SQLite's online backup
    includes them. It neither stops the recorder nor is stopped by it.

    **Arguments:**

    - `file`: the recording.
    - `copy`: the path of the copy. An existing file is refused.

    **Returns:** the SHA-256 of the copy. It is also written to `COPY.sha256`, which
    `sha256sum --check` reads.

    **Raises:** `RecordingError` if the file is not a recording, or the copy cannot be written.
    """
    target = Path(copy)
    beside = target.with_name(target.name + ".sha256")
    for path in (target, beside):
        if os.path.lexists(path):
            raise RecordingError(f"{path}: expected a new file, got an existing one; name another")
    partial = target.with_name(f".{target.name}.{uuid.uuid4().hex}.part")
    try:
        # Nobody else has made this file: it is no link to another.
        os.close(os.open(partial, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644))
        with Session(file) as session:
            # The copy is a single file, which includes the journal of the source.
            database = sqlite3.connect(partial)
            try:
                session.database.backup(database, pages=PAGES)
                database.execute("PRAGMA journal_mode = DELETE")
                (sound,) = database.execute("PRAGMA integrity_check").fetchone()
            finally:
                database.close()
        if sound != "ok":
            raise RecordingError(f"{file}: is damaged: {sound}")
        with partial.open("rb+") as stream:
            checksum = hashlib.file_digest(stream, "sha256").hexdigest()
            os.fsync(stream.fileno())
        with beside.open("x", encoding="utf-8") as stream:
            stream.write(f"{checksum}  {target.name}\n")
        partial.replace(target)
    except (sqlite3.Error, OSError) as error:
        raise RecordingError(f"{target}: cannot be written: {error}") from None
    finally:
        partial.unlink(missing_ok=True)
    return checksum
