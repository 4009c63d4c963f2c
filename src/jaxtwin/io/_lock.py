"""Ensures that each recording has a single writer, by a lock that ends with the process in any
case."""

import os
import sys
from pathlib import Path

from .._errors import RecordingError


def lock(file: Path) -> int:
    """Locks a recording for writing by an empty file beside it.

    SQLite's own locks last for a transaction, so that two recorders could write in turns unnoticed.
    Symbolic links are resolved first. A file with several names (hard links) is refused, because
    the lock belongs to a name.

    **Returns:** the handle that `unlock` needs.

    **Raises:** `RecordingError` if another process records into it, or it has hard links.
    """
    if file.exists() and (names := file.stat().st_nlink) > 1:
        raise RecordingError(
            f"{file}: expected a file with one name, because a lock follows a name, got {names} "
            "(hard links); copy the file"
        )
    beside = _beside(file)
    try:
        handle = os.open(beside, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise RecordingError(f"{file}: cannot be written: {error.strerror}") from None
    try:
        _lock(handle)
    except OSError:
        os.close(handle)
        raise RecordingError(
            f"{file}: another process records into it; stop that one, or choose another file"
        ) from None
    return handle


def unlock(handle: int) -> None:
    """Lets other processes record into it. The empty file remains, because removing it would race
    with them."""
    os.close(handle)


def is_locked(file: Path) -> bool:
    """Whether a process records into the file."""
    if not _beside(file).exists():
        return False
    try:
        unlock(lock(file))
    except RecordingError:
        return True
    return False


def _beside(file: Path) -> Path:
    file = file.resolve()
    return file.with_name(file.name + "-lock")


if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
