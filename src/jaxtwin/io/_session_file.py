"""The file into which a live session is recorded: how it is recognised, its single writer, and its
metadata about the rig.

`live/recording/_tables.py` makes its tables; docs/protocol.md describes them for other programs.
"""

import contextlib
import json
import os
import reprlib
import sqlite3
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from ..errors import RecordingError
from ..rig import is_channel_name

# Ensures that each recording has a single writer, by a lock that ends with the process in any case.


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


# SQLite's `application_id` of a session, "jtw1", which `file` and SQLite tools show.
APPLICATION = 0x6A747731

# Version of the tables.
FORMAT = 2

# The metadata of a recording about its rig, with the type of each entry.
_METADATA = {
    "rig": "text",
    "rig_file": "text",
    "cells": "names",
    "channels": "names",
    "counts": "count",
    "polarity": "sign",
    "camera": "size",
}

_SQLITE = b"SQLite format 3\0"
_APPLICATION_BYTES = slice(68, 72)  # where the file's header holds the `application_id`


def is_session(file: Path) -> bool:
    """Whether a recorder made this file; `False` also if it cannot be read.

    The file's first bytes are read without SQLite, which may leave files beside it.
    """
    if is_locked(file):
        # Not opened: closing it would release the locks that SQLite holds in this process.
        return True
    try:
        with file.open("rb") as stream:
            header = stream.read(_APPLICATION_BYTES.stop)
    except OSError:
        return False
    number = APPLICATION.to_bytes(4, "big")
    return header.startswith(_SQLITE) and header[_APPLICATION_BYTES] == number


@final
@dataclass(frozen=True)
class Columns:
    """Names of the columns that depend on the rig."""

    pwm: tuple[str, ...]
    temperatures: tuple[str, ...]

    @classmethod
    def of(cls, metadata: dict[str, Any]) -> "Columns":
        """Makes the names from the metadata of a recording."""
        return cls(
            pwm=tuple(f"pwm_{cell}" for cell in metadata["cells"]),
            temperatures=tuple(f"{channel}_degC" for channel in metadata["channels"]),
        )


@contextlib.contextmanager
def damage_as_recording_error(file: Path) -> Iterator[None]:
    """Turns errors of code that reads rows inside the block into an error that says that the
    recording is damaged.

    SQLite notices some damage itself; other damage leaves rows with text instead of numbers.

    **Raises:** `RecordingError`.
    """
    try:
        yield
    except (sqlite3.Error, ValueError, KeyError, TypeError, OverflowError) as error:
        why = str(error) or type(error).__name__
        raise RecordingError(f"{file}: is damaged, and cannot be read: {why}") from None


def read_metadata(database: sqlite3.Connection, file: Path) -> dict[str, Any]:
    """The metadata of a recording.

    **Raises:** `RecordingError` if the file is not a recording, or is one of a later version.
    """
    try:
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (form,) = database.execute("PRAGMA user_version").fetchone()
        if application != APPLICATION:
            raise RecordingError(
                f"{file}: expected a recording of a live rig, got another SQLite database"
            )
        if form != FORMAT:
            later = " by a newer jaxtwin; update this one to read it" if form > FORMAT else ""
            raise RecordingError(
                f"{file}: format: expected {FORMAT}, got {form}, as it was written{later}"
            )
        _check_tables(database, file)
        rows = database.execute("SELECT key, value FROM session").fetchall()
        metadata = {key: json.loads(value) for key, value in rows}
    except sqlite3.DatabaseError as error:
        raise RecordingError(f"{file}: cannot be read: {error}") from None
    except (TypeError, ValueError):
        raise RecordingError(f"{file}: is damaged: its metadata are no JSON") from None
    for key, kind in _METADATA.items():
        if not _fits(metadata.get(key), kind):
            result = reprlib.repr(metadata.get(key))
            raise RecordingError(f"{file}: is damaged: its metadata say {key} = {result}")
    return metadata


def _check_tables(database: sqlite3.Connection, file: Path) -> None:
    """Refuses a file in which another program's code would run in place of a table: a view may
    never end, and a virtual table belongs to an extension."""
    database.execute("PRAGMA trusted_schema = OFF")
    odd = database.execute(
        "SELECT type, name FROM sqlite_schema WHERE type = 'view' "
        "OR upper(sql) LIKE 'CREATE VIRTUAL%' LIMIT 1"
    ).fetchone()
    if odd is not None:
        raise RecordingError(
            f"{file}: expected the tables of a recording, got the {odd[0]} {odd[1]!r}, which no "
            "recorder makes"
        )


def _fits(value: Any, kind: str) -> bool:
    # Names become parts of SQL.
    names = isinstance(value, list) and all(
        isinstance(item, str) and is_channel_name(item) for item in value
    )
    match kind:
        case "text":
            return isinstance(value, str)
        case "names":
            return names and len(set(map(str.lower, value))) == len(value) > 0
        case "count":
            return type(value) is int and 1 <= value <= 2**31
        case "sign":
            return value in (-1, 1)
    pair = isinstance(value, list) and len(value) == 2
    return value is None or (pair and all(type(side) is int and 0 < side <= 4096 for side in value))
