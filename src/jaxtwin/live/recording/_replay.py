"""Replays a recording: the same records in the order of their arrival, at any speed."""

import heapq
import json
import sqlite3
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np

from ...errors import RecordingError
from ...io import Columns, Session, damage_as_recording_error
from ...rig import Rig
from ..protocol._clock import Clock, SystemClock
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


# The largest number of records of one poll.
MAX_AT_ONCE = 1000


@final
class Replay:
    """Yields the records of a recording as they came. It is used like a `RigConnection`.

    Records keep the times of the recording. Records that arrived together in a single read are
    ordered by kind. Frames are included if the recorder kept them.

    **Arguments:**

    - `file`: a recording.
    - `speed`: the recorded seconds in a second; infinite: as fast as the records are read.
    - `clock`: host time.

    **Raises:** `RecordingError` if the file is not a recording or is damaged; damage may also be
    found later, while the file is read.
    """

    def __init__(self, file: str | Path, *, speed: float | int = 1.0, clock: Clock | None = None):
        self.clock: Clock = clock or SystemClock()
        self.states: dict[str, LinkState] = {}
        self.session = Session(file)
        self._speed = speed
        self._tables = RowReader(self.session).tables()
        # Of records that arrived together, greetings come first: the others refer to them.
        self._records = heapq.merge(*self._tables, key=lambda record: record.arrival)
        self._upcoming: Record | None = next(self._records, None)
        self._begin: int | None = None
        self._first = self._upcoming.arrival if self._upcoming else 0
        self._never = threading.Event()

    def __enter__(self) -> "Replay":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Record]:
        """Yields all records."""
        while not self.ended:
            yield from self.poll()

    @property
    def ended(self) -> bool:
        """Whether all records have been handed out."""
        return self._upcoming is None

    def check_rig(self, rig: Rig) -> None:
        """Refuses a recording of another rig.

        **Raises:** `RecordingError` that names both.
        """
        recorded = self.session.rig
        if (recorded.name, recorded.channels) != (rig.name, rig.channels):
            raise RecordingError(
                f"{self.session.file}: rig: expected a recording of {rig.name!r}, got one of "
                f"{recorded.name!r}"
            )

    def poll(self, timeout: float | int = 0.1) -> list[Record]:
        """Returns the records that are due, after waiting for at most `timeout` seconds."""
        if self._begin is None:
            self._begin = self.clock.now()
        if not self._is_due() and self._upcoming is not None:
            self.clock.wait(self._never, min(timeout, self._until_due()))
        records: list[Record] = []
        while self._upcoming is not None and len(records) < MAX_AT_ONCE and self._is_due():
            records.append(self._upcoming)
            if isinstance(self._upcoming, LinkChange):
                self.states[self._upcoming.link] = self._upcoming.state
            self._upcoming = next(self._records, None)
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
