"""Is a file a recording of a live rig? Answered without SQLite, which may leave files beside it."""

from pathlib import Path

from ._lock import is_locked

APPLICATION = 0x6A747731  # "jtw1", in the file's header: what `file` and SQLite tools show

_SQLITE = b"SQLite format 3\0"
_PLACE = slice(68, 72)  # of the application's number in the header


def is_recording(file: Path) -> bool:
    """Whether a recorder made this file; `False` also where it cannot be read."""
    if is_locked(file):
        # Not opened: closing it would release the locks that SQLite holds in this process.
        return True
    try:
        with file.open("rb") as stream:
            header = stream.read(_PLACE.stop)
    except OSError:
        return False
    return header.startswith(_SQLITE) and header[_PLACE] == APPLICATION.to_bytes(4, "big")
