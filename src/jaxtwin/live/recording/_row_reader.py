"""Reads records from the rows of a recording's tables."""

import json
import sqlite3
from collections.abc import Generator
from typing import Any, TypeAlias, final

import numpy as np

from ...io import Session
from ...io._session_file import Columns, damage_as_recording_error
from ..protocol._messages import Hello
from ..protocol._records import (
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

Rows: TypeAlias = Generator[Record, None, None]


@final
class RowReader:
    """Reads the records of a recording, each table in its order and as they are needed.

    **Raises:** `RecordingError` if the recording is damaged, also while it is read.
    """

    def __init__(self, session: Session):
        self._session = session
        with damage_as_recording_error(session.file):
            self._columns = Columns.of(session.metadata)
            self._devices = {
                number: (link, boot)
                for number, link, boot in self._rows("SELECT id, link, boot FROM greetings")
            }

    def tables(self) -> tuple[Rows, ...]:
        """The records of each table; greetings are first, because others refer to them."""
        tables = (
            self._greetings(),
            self._changes_and_events(),
            self._gaps(),
            self._commands(),
            self._documents(),
            self._samples(),
            self._readings(),
        )
        return tuple(map(self._told, tables))

    def _told(self, table: Rows) -> Rows:
        with damage_as_recording_error(self._session.file):
            yield from table

    def _rows(self, query: str) -> Generator[tuple[Any, ...], None, None]:
        # A separate cursor, because the tables are read in turns.
        yield from sqlite3.Cursor(self._session.database).execute(query)

    def _greetings(self) -> Rows:
        for link, arrival, hello in self._rows(
            "SELECT link, arrival, hello FROM greetings ORDER BY id"
        ):
            content = json.loads(hello)
            lists = {key: tuple(part) for key, part in content.items() if isinstance(part, list)}
            yield Greeting(link, arrival, Hello(**content | lists))

    def _changes_and_events(self) -> Rows:
        query = "SELECT link, arrival, device_us, seq, kind, detail FROM events ORDER BY id"
        for link, arrival, device_us, seq, kind, detail in self._rows(query):
            state = kind.removeprefix("link-")
            if kind != state and state in set(LinkState):
                yield LinkChange(link, arrival, LinkState(state), detail)
            else:  # also what a later version may write
                yield Event(link, arrival, kind, detail, device_us, seq)

    def _gaps(self) -> Rows:
        query = 'SELECT link, arrival, stream, "first", count FROM gaps ORDER BY id'
        for row in self._rows(query):
            yield Gap(*row)

    def _commands(self) -> Rows:
        for _, _, link, arrival, number, owner, kind, *pwm in self._rows(
            "SELECT * FROM commands ORDER BY id"
        ):
            counts = tuple(pwm) if kind == "duty" else ()
            yield Command(link, arrival, number, counts, owner, kind)

    def _documents(self) -> Rows:
        query = "SELECT arrival, kind, uid, content FROM documents ORDER BY id"
        for arrival, kind, uid, content in self._rows(query):
            yield Document(arrival, kind, uid, json.loads(content))

    def _samples(self) -> Rows:
        for row in self._rows("SELECT * FROM samples ORDER BY id"):
            _, greeting, arrival, device_us, seq, ambient, owner, number, trip, *pwm = row
            stamp = arrival, device_us, seq
            state = owner, number, trip
            counts = () if None in pwm else tuple(pwm)  # a device without cells has none
            yield Sample(*self._devices[greeting], *stamp, counts, ambient, *state)

    def _readings(self) -> Rows:
        # Sensors give no frames.
        width, height = self._session.metadata["camera"] or (0, 0)
        names = ", ".join(f'"{name}"' for name in self._columns.temperatures)
        query = (
            f"SELECT greeting, arrival, device_us, seq, recalibrating, pixels, {names} "
            "FROM readings LEFT JOIN frames ON frames.reading = readings.id ORDER BY id"
        )
        for greeting, arrival, device_us, seq, flag, content, *values in self._rows(query):
            pixels = None
            if content is not None:
                pixels = np.frombuffer(content, "<u2").reshape(height, width).astype(np.uint16)
            yield Reading(
                *self._devices[greeting],
                arrival,
                device_us,
                seq,
                np.array(values, np.float64),  # no value is NaN
                bool(flag),
                pixels,
            )
