"""Writes records as rows of a recording's tables."""

import json
import sqlite3
from dataclasses import asdict
from typing import Any, final

from ..protocol._records import (
    Command,
    Document,
    Event,
    Gap,
    Greeting,
    LinkChange,
    Reading,
    Record,
    Sample,
    StateEstimate,
)
from ._tables import create_estimates


@final
class RowWriter:
    """Writes the records of one run.

    **Arguments:**

    - `database`: the database, with the tables of `_tables.py`.
    - `run`: the number of the run.
    - `shift`: the difference between the recording's time and the clock's, ns.
    - `cells`: the number of cells of the rig.
    - `keep_frames`: whether camera frames are kept as well as the channels taken from them.
    """

    def __init__(
        self, database: sqlite3.Connection, run: int, shift: int, cells: int, *, keep_frames: bool
    ):
        self._database = database
        self._run, self._shift, self._cells = run, shift, cells
        self._keep_frames = keep_frames
        self._greetings: dict[tuple[str, str], int] = {}
        self._estimated: tuple[str, ...] | None = None
        self._keeps_estimates = True

    def insert(self, record: Record) -> None:
        """Writes a record, inside the caller's transaction."""
        shift = self._shift
        match record:
            case Sample():
                device = self._device(record)
                state = record.owner, record.number, record.trip
                counts = record.pwm or [None] * self._cells  # a camera has none
                self._row("samples", (None, *device, record.ambient, *state, *counts))
            case Reading():
                device = self._device(record)
                values = record.temperatures.tolist()
                row = self._row("readings", (None, *device, int(record.recalibrating), *values))
                if self._keep_frames and record.pixels is not None:
                    self._row("frames", (row, record.pixels.astype("<u2").tobytes()))
            case Greeting(link, arrival, hello):
                content = json.dumps(asdict(hello))
                row = (None, self._run, link, arrival + shift, hello.boot, hello.rate, content)
                self._greetings[link, hello.boot] = self._row("greetings", row)
            case Gap(link, arrival, stream, first, count):
                self._row("gaps", (None, self._run, link, arrival + shift, stream, first, count))
            case LinkChange(link, arrival, state, detail):
                what = None, None, f"link-{state}", detail
                self._row("events", (None, self._run, link, arrival + shift, *what))
            case Event(link, arrival, kind, detail, device_us, seq):
                what = device_us, seq, kind, detail
                self._row("events", (None, self._run, link, arrival + shift, *what))
            case Document(arrival, kind, uid, content):
                text = json.dumps(content)
                self._row("documents", (None, self._run, arrival + shift, kind, uid, text))
            case StateEstimate(arrival, twin, values):
                if self._estimated != tuple(values):
                    self._estimated = tuple(values)
                    problem = create_estimates(self._database, self._estimated)
                    self._keeps_estimates = not problem
                    if problem:  # what an observer says must not stop the readings
                        what = None, None, "estimates-dropped", problem
                        self._row("events", (None, self._run, "", arrival + shift, *what))
                if self._keeps_estimates:
                    row = (None, self._run, arrival + shift, twin, *values.values())
                    self._row("estimates", row)
            case Command(link, arrival, number, pwm, owner, kind):
                counts = pwm or [None] * self._cells
                what = number, owner, kind, *counts
                self._row("commands", (None, self._run, link, arrival + shift, *what))

    def _device(self, record: Sample | Reading) -> tuple[int, int, int, int]:
        greeting = self._greetings[record.link, record.boot]
        return greeting, record.arrival + self._shift, record.device_us, record.seq

    def _row(self, table: str, values: tuple[Any, ...]) -> int:
        marks = ",".join("?" * len(values))
        cursor = self._database.execute(f"INSERT INTO {table} VALUES ({marks})", values)
        return cursor.lastrowid or 0
