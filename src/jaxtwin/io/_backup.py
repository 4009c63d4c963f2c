"""Copies a recording while it grows, with a checksum in a second file."""

import hashlib
import os
import sqlite3
import uuid
from pathlib import Path

from ..errors import RecordingError
from ._session import Session

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
