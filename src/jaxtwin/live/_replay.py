"""Replay of a recording: the same records in the order of their arrival, at any speed."""

import heapq
import json
import sqlite3
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, final

import numpy as np

from ..io import Session
from ..io._session_file import Columns, damage_as_recording_error
from ._messages import Hello
from ._records import (
    Command,
    Document,
    Event,
    Gap,
    Greeting,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Sample,
)
from ._time import Clock, SystemClock
from ._view import View

Rows = Generator[Record, None, None]

MOST_AT_ONCE = 1000
"""Largest number of records of one poll."""


@final
class Replay:
    """Yields the records that the bench yielded during the recording. It is used like a `Bench`.

    Records keep the times of the recording; those of one read, which arrived together, come by
    kind. Frames are there where the recorder kept them.

    **Arguments:**

    - `file`: a recording.
    - `speed`: recorded seconds in a second; infinite: as fast as the records are read.
    - `clock`: host time.

    **Raises:** `RecordingError` where it is no recording, or is damaged: then also while it is
    read.
    """

    def __init__(self, file: str | Path, *, speed: float | int = 1.0, clock: Clock | None = None):
        self.clock: Clock = clock or SystemClock()
        self.states: dict[str, LinkState] = {}
        self.session = Session(file)
        self._speed = speed
        with damage_as_recording_error(self.session.file):
            self._tables = tuple(map(self._told, self._all()))
        # Of records that arrived together, greetings come first: the others refer to them.
        self._records = heapq.merge(*self._tables, key=lambda record: record.arrival)
        self._upcoming: Record | None = next(self._records, None)
        self._views: list[View] = []
        self._begin: int | None = None
        self._first = self._upcoming.arrival if self._upcoming else 0
        self._never = threading.Event()

    def __enter__(self) -> "Replay":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Record]:
        """All records, then the end."""
        while not self.ended:
            yield from self.poll()

    @property
    def ended(self) -> bool:
        """Whether all records have been handed out."""
        return self._upcoming is None

    def view(self, capacity: int = 10_000) -> View:
        """A view of all records from now on, of which at most `capacity` wait."""
        view = View(capacity)
        self._views.append(view)
        return view

    def poll(self, timeout: float | int = 0.1) -> list[Record]:
        """The records that are due, after waiting for at most `timeout` seconds."""
        if self._begin is None:
            self._begin = self.clock.now()
        if not self._is_due() and self._upcoming is not None:
            self.clock.wait(self._never, min(timeout, self._until_due()))
        records: list[Record] = []
        while self._upcoming is not None and len(records) < MOST_AT_ONCE and self._is_due():
            records.append(self._upcoming)
            if isinstance(self._upcoming, LinkChange):
                self.states[self._upcoming.link] = self._upcoming.state
            self._upcoming = next(self._records, None)
        for view in self._views:
            view.put(records)
        return records

    def send_duty(self, pwm: tuple[int, ...]) -> bool:
        """A replay drives nothing: always false, as on a lost link."""
        return False

    def close(self) -> None:
        """Closes the file."""
        for table in self._tables:  # their cursors first
            table.close()
        self.session.close()

    def _is_due(self) -> bool:
        return self._upcoming is not None and self._until_due() <= 0

    def _until_due(self) -> float:
        assert self._upcoming is not None
        assert self._begin is not None
        if self._speed == float("inf"):
            return 0.0
        recorded = (self._upcoming.arrival - self._first) * 1e-9
        return recorded / self._speed - (self.clock.now() - self._begin) * 1e-9

    def _told(self, rows: Rows) -> Rows:
        with damage_as_recording_error(self.session.file):
            yield from rows

    def _all(self) -> tuple[Rows, ...]:
        """The records of each table; read as they are needed."""
        database = self.session.database
        columns = Columns.of(self.session.metadata)
        # Sensors give no frames.
        width, height = self.session.metadata["camera"] or (0, 0)
        devices = {
            number: (link, boot)
            for number, link, boot in database.execute("SELECT id, link, boot FROM greetings")
        }

        def rows(query: str) -> Generator[tuple[Any, ...], None, None]:
            # A separate cursor, because five tables are read in turns.
            yield from sqlite3.Cursor(database).execute(query)

        def greetings() -> Rows:
            for link, arrival, hello in rows(
                "SELECT link, arrival, hello FROM greetings ORDER BY id"
            ):
                content = json.loads(hello)
                for field in ("cells", "channels", "camera"):
                    content[field] = tuple(content[field]) if content[field] is not None else None
                yield Greeting(link, arrival, Hello(**content))

        def changes_and_events() -> Rows:
            query = "SELECT link, arrival, device_us, seq, kind, detail FROM events ORDER BY id"
            for link, arrival, device_us, seq, kind, detail in rows(query):
                state = kind.removeprefix("link-")
                if kind != state and state in set(LinkState):
                    yield LinkChange(link, arrival, LinkState(state), detail)
                else:  # also what a later version may write
                    yield Event(link, arrival, kind, detail, device_us, seq)

        def gaps() -> Rows:
            for row in rows('SELECT link, arrival, stream, "first", count FROM gaps ORDER BY id'):
                yield Gap(*row)

        def commands() -> Rows:
            for _, _, link, arrival, number, owner, kind, *pwm in rows(
                "SELECT * FROM commands ORDER BY id"
            ):
                counts = tuple(pwm) if kind == "duty" else ()
                yield Command(link, arrival, number, counts, owner, kind)

        def documents() -> Rows:
            query = "SELECT arrival, kind, uid, content FROM documents ORDER BY id"
            for arrival, kind, uid, content in rows(query):
                yield Document(arrival, kind, uid, json.loads(content))

        def samples() -> Rows:
            for row in rows("SELECT * FROM samples ORDER BY id"):
                _, greeting, arrival, device_us, seq, ambient, owner, number, trip, *pwm = row
                stamp = arrival, device_us, seq
                state = owner, number, trip
                yield Sample(*devices[greeting], *stamp, tuple(pwm), ambient, *state)

        def readings() -> Rows:
            names = ", ".join(f'"{name}"' for name in columns.temperatures)
            query = (
                f"SELECT greeting, arrival, device_us, seq, recalibrating, pixels, {names} "
                "FROM readings LEFT JOIN frames ON frames.reading = readings.id ORDER BY id"
            )
            for greeting, arrival, device_us, seq, flag, content, *values in rows(query):
                pixels = None
                if content is not None:
                    pixels = np.frombuffer(content, "<u2").reshape(height, width).astype(np.uint16)
                yield Reading(
                    *devices[greeting],
                    arrival,
                    device_us,
                    seq,
                    np.array(values, np.float64),  # no value is NaN
                    bool(flag),
                    pixels,
                )

        return (
            greetings(),
            changes_and_events(),
            gaps(),
            commands(),
            documents(),
            samples(),
            readings(),
        )
