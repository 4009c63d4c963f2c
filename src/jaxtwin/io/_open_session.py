"""Opens a recording for reading, also while it is written."""

import sqlite3
from pathlib import Path
from urllib.parse import quote

from ..errors import RecordingError
from ._lock import is_locked


def open_session(file: Path) -> sqlite3.Connection:
    """Opens the file for reading, so that a recorder never waits and no row can be changed.

    If a reader with write access is the last to close the file, SQLite removes the journal and its
    index. This must not happen while a recorder uses the file; the lock shows whether one does.
    """
    attempts = [("mode=ro", "NORMAL")]
    if not is_locked(file):
        # The index needs room beside the file. A full disk denies that: it is kept in memory then.
        attempts = [("mode=rw", "NORMAL"), ("mode=rw", "EXCLUSIVE")]
        if not file.with_name(file.name + "-wal").exists():
            # Without a journal no index is needed, as on a write-protected disk.
            attempts.append(("mode=ro&immutable=1", "NORMAL"))
    problem = ""
    for access, locking in attempts:
        try:
            return _connect(file, access, locking)
        except sqlite3.DatabaseError as error:
            problem = problem or str(error)
    raise RecordingError(f"{file}: cannot be read: {problem}")


def _connect(file: Path, access: str, locking: str) -> sqlite3.Connection:
    location = f"file:{quote(str(file.absolute()))}?{access}"
    # A replay may be read by another thread than that which opened it.
    database = sqlite3.connect(location, uri=True, isolation_level=None, check_same_thread=False)
    try:
        database.execute("PRAGMA query_only = ON")
        database.execute(f"PRAGMA locking_mode = {locking}")
        database.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except sqlite3.DatabaseError:
        database.close()
        raise
    except UnicodeDecodeError:  # SQLite quotes a damaged name in its own message
        database.close()
        raise sqlite3.DatabaseError("its schema is damaged") from None
    return database
