"""The file into which a live session is recorded: how it is recognised, and its metadata about the
rig.

`live/recording/_tables.py` makes its tables; docs/protocol.md describes them for other programs.
"""

import contextlib
import json
import reprlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from ..errors import RecordingError
from ..rig import is_channel_name
from ._lock import is_locked

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
