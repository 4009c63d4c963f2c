"""The journal of a fleet: an SQLite file with the messages of each rig, its findings, and the state
of its observer, from which a process that begins again goes on."""

import json
import sqlite3
import threading
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, final

from ..errors import RecordingError
from ..live import Finding, finding_as_json
from ._sample_queue import Kind

# The version of the tables. One with other tables is refused.
VERSION = 1

_TABLES = """
CREATE TABLE IF NOT EXISTS rigs (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE);
CREATE TABLE IF NOT EXISTS messages (
    number INTEGER PRIMARY KEY AUTOINCREMENT, rig INTEGER NOT NULL, arrival INTEGER NOT NULL,
    kind TEXT NOT NULL, payload BLOB NOT NULL);
CREATE INDEX IF NOT EXISTS messages_of_rig ON messages (rig, number);
CREATE TABLE IF NOT EXISTS findings (
    rig INTEGER NOT NULL, kind TEXT NOT NULL, channel TEXT NOT NULL, found INTEGER NOT NULL,
    content TEXT NOT NULL, PRIMARY KEY (rig, kind, channel, found));
CREATE TABLE IF NOT EXISTS states (
    rig INTEGER PRIMARY KEY, twin TEXT NOT NULL, content TEXT NOT NULL, lane BLOB NOT NULL);
"""


class Message(NamedTuple):
    """A message of a rig, `payload`, that arrived at a host time, ns, with its number."""

    number: int
    rig: str
    kind: Kind
    payload: bytes


class StoredState(NamedTuple):
    """The state of a rig: of which twin, what is known in JSON, and that of its lane."""

    twin: str
    content: dict[str, Any]
    lane: bytes


@final
class FleetJournal:
    """Keeps the messages of a fleet. Several threads may use it.

    **Arguments:**

    - `path`: the file; it is made if it is not there.

    **Raises:** `RecordingError` for a file that is no journal of a fleet.
    """

    def __init__(self, path: Path):
        self._path, self._lock = path, threading.RLock()
        try:
            self._database = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            # A kill loses nothing; the failure of a machine loses what it had not written yet.
            self._database.execute("PRAGMA synchronous=NORMAL")
            (version,) = self._database.execute("PRAGMA user_version").fetchone()
            (tables,) = self._database.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if version != VERSION and tables:
                raise sqlite3.DatabaseError(f"no journal of a fleet of version {VERSION}")
            self._database.executescript(f"{_TABLES} PRAGMA user_version = {VERSION};")
        except sqlite3.Error as problem:
            raise RecordingError(
                f"{path}: expected the journal of a fleet, or no file: {problem}"
            ) from None
        rows = self._database.execute("SELECT name, id FROM rigs")
        self._ids: dict[str, int] = dict(rows.fetchall())

    def close(self) -> None:
        """Closes the file."""
        self._database.close()

    def add(self, arrival: int, messages: Sequence[tuple[str, Kind, bytes]]) -> list[Message]:
        """Keeps messages that arrived at a host time, ns, before anything uses them."""
        with self._writing():
            rows = [(self._id(rig), arrival, kind, text) for rig, kind, text in messages]
            self._database.executemany(
                "INSERT INTO messages (rig, arrival, kind, payload) VALUES (?, ?, ?, ?)", rows
            )
            (last,) = self._database.execute("SELECT last_insert_rowid()").fetchone()
        first = last - len(rows) + 1
        return [Message(first + place, *message) for place, message in enumerate(messages)]

    def after(self, rig: str, number: int, count: int) -> list[Message]:
        """The next messages of a rig after one, at most `count`."""
        query = (
            "SELECT number, kind, payload FROM messages WHERE rig = ? AND number > ? "
            "ORDER BY number LIMIT ?"
        )
        rows = self._all(query, self._id(rig), number, count)
        return [Message(row[0], rig, *row[1:]) for row in rows]

    def last(self, rig: str, count: int) -> list[Message]:
        """The last messages of a rig, at most `count`."""
        query = "SELECT number, kind, payload FROM messages WHERE rig = ? ORDER BY number DESC"
        rows = self._all(f"{query} LIMIT ?", self._id(rig), count)
        return [Message(row[0], rig, *row[1:]) for row in reversed(rows)]

    def find(self, rig: str, finding: Finding) -> bool:
        """Keeps a finding of a rig; false if it was kept before, as after a restart."""
        content = json.dumps(finding_as_json(finding))
        row = (self._id(rig), finding.kind, finding.channel, int(finding.found or 0), content)
        with self._lock:
            query = "INSERT OR IGNORE INTO findings VALUES (?, ?, ?, ?, ?)"
            return self._database.execute(query, row).rowcount == 1

    def findings(self, rig: str, count: int) -> list[dict[str, Any]]:
        """The last findings of a rig, as JSON, the newest first."""
        query = "SELECT content FROM findings WHERE rig = ? ORDER BY found DESC LIMIT ?"
        return [json.loads(text) for (text,) in self._all(query, self._id(rig), count)]

    def keep_states(self, states: dict[str, StoredState]) -> None:
        """Keeps the states of some rigs in place of those before."""
        with self._writing():
            self._database.executemany(
                "INSERT OR REPLACE INTO states VALUES (?, ?, ?, ?)",
                [
                    (self._id(rig), state.twin, json.dumps(state.content), state.lane)
                    for rig, state in states.items()
                ],
            )

    def state(self, rig: str) -> StoredState | None:
        """The state of a rig that was kept last."""
        query = "SELECT twin, content, lane FROM states WHERE rig = ?"
        for twin, content, lane in self._all(query, self._id(rig)):
            return StoredState(twin, json.loads(content), lane)
        return None

    def forget(self, arrival: int) -> None:
        """Removes some of the messages that arrived before a host time, ns."""
        with self._lock:
            query = (
                "DELETE FROM messages WHERE number IN "
                "(SELECT number FROM messages ORDER BY number LIMIT 5000) AND arrival < ?"
            )
            self._database.execute(query, (arrival,))

    @contextmanager
    def _writing(self) -> Generator[None]:
        """A transaction.

        **Raises:** `RecordingError` if it cannot be written, as to a full disk.
        """
        try:
            with self._lock, self._database:
                self._database.execute("BEGIN")
                yield
        except sqlite3.Error as problem:
            raise RecordingError(f"{self._path}: cannot be written: {problem}") from None

    def _all(self, query: str, *values: object) -> list[Any]:
        with self._lock:
            return self._database.execute(query, values).fetchall()

    def _id(self, rig: str) -> int:
        if rig not in self._ids:
            with self._lock:
                cursor = self._database.execute("INSERT INTO rigs (name) VALUES (?)", (rig,))
                assert cursor.lastrowid is not None
                self._ids[rig] = cursor.lastrowid
        return self._ids[rig]
