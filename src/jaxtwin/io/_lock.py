"""Ensures that each recording has a single writer, by a lock that ends with the process in any
case."""

import os
import sys
from pathlib import Path

from ..errors import RecordingError


def lock(file: Path) -> list[int]:
    """Locks a recording for writing, by an empty file beside it and by the file itself.

    SQLite's own locks last for a transaction, so that two recorders could write in turns unnoticed.
    The file beside it shows readers that somebody writes, without an access to the recording. The
    recording itself is locked too, because the file beside it can be deleted. It is created if it
    is missing. Symbolic links are resolved first. A file with several names (hard links) is
    refused, because the lock belongs to a name.

    **Returns:** the handles that `unlock` needs.

    **Raises:** `RecordingError` if another process records into it, or it has hard links.
    """
    if file.exists() and (names := file.stat().st_nlink) > 1:
        raise RecordingError(
            f"{file}: expected a file with one name, because a lock follows a name, got {names} "
            "(hard links); copy the file"
        )
    handles: list[int] = []
    for path in (_beside(file), file)[:LOCKED]:
        try:
            handles.append(os.open(path, os.O_RDWR | os.O_CREAT, 0o644))
        except OSError as error:
            unlock(handles)
            raise RecordingError(f"{file}: cannot be written: {error.strerror}") from None
        try:
            _lock(handles[-1])
        except OSError:
            unlock(handles)
            raise RecordingError(
                f"{file}: another process records into it; stop that one, or choose another file"
            ) from None
    return handles


def unlock(handles: list[int]) -> None:
    """Lets other processes record into it. The empty file remains, because removing it would race
    with them. SQLite must have closed the recording before: its own locks end with any handle of
    the file."""
    for handle in handles:
        os.close(handle)


def is_locked(file: Path) -> bool:
    """Whether a process records into the file. The recording itself is not opened, since closing it
    again would release the locks of SQLite in this process."""
    beside = _beside(file)
    if not beside.exists():
        return False
    try:
        handle = os.open(beside, os.O_RDWR)
    except OSError:
        return True
    try:
        _lock(handle)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _beside(file: Path) -> Path:
    file = file.resolve()
    return file.with_name(file.name + "-lock")


if sys.platform == "win32":
    import msvcrt

    LOCKED = 1  # an open file cannot be deleted there, and a locked one not read

    def _lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    LOCKED = 2

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
