"""The tables of a recording, one for each stream; docs/protocol.md describes them for other
programs."""

import json
import platform
import sqlite3
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from ...errors import RecordingError
from ...io import APPLICATION, FORMAT, Columns
from ...rig import Rig
from ..protocol._identity import Identity

_APPEND_ONLY = (
    "session",
    "runs",
    "greetings",
    "samples",
    "readings",
    "frames",
    "gaps",
    "events",
    "commands",
    "documents",
)


def metadata_of(rig: Rig) -> dict[str, Any]:
    """The metadata of a recording about its rig.

    **Raises:** `RecordingError` if names differ only in upper and lower case, which SQLite does not
    distinguish.
    """
    identity = Identity.of(rig)
    for names in (identity.cells, identity.channels):
        for place, name in enumerate(names):
            twins = [other for other in names[:place] if other.lower() == name.lower()]
            if twins:
                raise RecordingError(
                    f"{rig.source}: expected names that differ in more than upper and lower case, "
                    f"got {twins[0]!r} and {name!r}, of which a recording cannot hold both; rename "
                    "one of them"
                )
    return {
        "format": FORMAT,
        "rig": identity.rig,
        "cells": identity.cells,
        "channels": identity.channels,
        "camera": identity.camera,
        "counts": identity.counts,
        "polarity": rig.driver.polarity,
        "rig_file": rig.text,
    }


def versions() -> dict[str, str]:
    """The versions of the programs that make a recording."""
    return {
        "jaxtwin": version("jaxtwin"),
        "python": platform.python_version(),
        "sqlite": sqlite3.sqlite_version,
        "numpy": version("numpy"),
        "system": platform.platform(),
    }


def mark(database: sqlite3.Connection) -> None:
    """Marks a new file as a recording. It must be called before the file has a journal, so that the
    mark is in the file itself."""
    database.execute(f"PRAGMA application_id = {APPLICATION}")


def create_tables(database: sqlite3.Connection, metadata: dict[str, Any]) -> None:
    """Makes the tables of a new recording, inside the caller's transaction."""
    columns = Columns.of(metadata)
    pwm = "".join(f', "{name}" INTEGER' for name in columns.pwm)
    temperatures = "".join(f', "{name}" REAL' for name in columns.temperatures)
    device = "greeting INTEGER, arrival INTEGER, device_us INTEGER, seq INTEGER"
    host = "run INTEGER, link TEXT, arrival INTEGER"
    for table, fields in {
        "session": "key TEXT PRIMARY KEY, value TEXT",
        "runs": "id INTEGER PRIMARY KEY, started INTEGER, alive INTEGER, alive_utc INTEGER, "
        "ended TEXT, versions TEXT",
        "greetings": f"id INTEGER PRIMARY KEY, {host}, boot TEXT, rate REAL, hello TEXT",
        "samples": f"id INTEGER PRIMARY KEY, {device}, ambient_degC REAL, "
        f"owner TEXT, number INTEGER, trip TEXT{pwm}",
        "readings": f"id INTEGER PRIMARY KEY, {device}, recalibrating INTEGER{temperatures}",
        "frames": "reading INTEGER PRIMARY KEY, pixels BLOB",
        "gaps": f'id INTEGER PRIMARY KEY, {host}, stream TEXT, "first" INTEGER, count INTEGER',
        "events": f"id INTEGER PRIMARY KEY, {host}, device_us INTEGER, seq INTEGER, kind TEXT, "
        "detail TEXT",
        "commands": f"id INTEGER PRIMARY KEY, {host}, number INTEGER, owner TEXT, kind TEXT{pwm}",
        "documents": "id INTEGER PRIMARY KEY, run INTEGER, arrival INTEGER, kind TEXT, uid TEXT, "
        "content TEXT",
    }.items():
        database.execute(f"CREATE TABLE {table} ({fields})")
    database.executemany(
        "INSERT INTO session VALUES (?, ?)",
        [(key, json.dumps(value)) for key, value in metadata.items()],
    )
    for table in _APPEND_ONLY:
        make_append_only(database, table)
    database.execute(f"PRAGMA user_version = {FORMAT}")


def create_estimates(database: sqlite3.Connection, names: Sequence[str]) -> str:
    """Makes the table of an observer's estimates, inside the caller's transaction; a recording
    without an observer has none.

    **Returns:** `""`, or what is wrong if there is one with other names.
    """
    columns = ["id", "run", "arrival", "twin", *names]
    there = [row[1] for row in database.execute("PRAGMA table_info(estimates)")]
    if not there:
        quoted = "".join(', "{}" REAL'.format(name.replace('"', '""')) for name in names)
        fields = f"id INTEGER PRIMARY KEY, run INTEGER, arrival INTEGER, twin TEXT{quoted}"
        database.execute(f"CREATE TABLE estimates ({fields})")
        make_append_only(database, "estimates")
    elif there != columns:
        odd = next(name for name in (*columns, *there) if name not in there or name not in columns)
        return (
            f"estimates: expected the columns that the recording has, got others, such as {odd!r}; "
            "record into a new file"
        )
    return ""


def make_append_only(database: sqlite3.Connection, table: str) -> None:
    """Makes triggers that refuse every change of a row."""
    # A run is alive until it has ended.
    when = "WHEN OLD.ended IS NOT NULL " if table == "runs" else ""
    for action, condition in (("UPDATE", when), ("DELETE", "")):
        database.execute(
            f"CREATE TRIGGER {table}_{action.lower()} BEFORE {action} ON {table} {condition}"
            "BEGIN SELECT RAISE(ABORT, 'a recording is append-only'); END"
        )
    # Without this, INSERT OR REPLACE would delete a row and not call the trigger of DELETE.
    key = {"frames": "reading", "session": "key"}.get(table, "id")
    database.execute(
        f"CREATE TRIGGER {table}_insert BEFORE INSERT ON {table} "
        f"WHEN EXISTS (SELECT 1 FROM {table} WHERE {key} = NEW.{key}) "
        "BEGIN SELECT RAISE(ABORT, 'a recording is append-only'); END"
    )
