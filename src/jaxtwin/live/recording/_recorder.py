"""The recorder writes records to an SQLite file that survives a kill of the process and a power
failure.

SQLite runs in WAL mode (https://sqlite.org/wal.html). Every call of `write` is one transaction,
handed to the operating system before it returns: a killed process loses nothing that was written.
Once a second a transaction is also forced onto the disk (`synchronous = FULL` for that one; it
takes all earlier ones with it): a power failure loses at most that second. A transaction that was
torn in the middle is dropped by SQLite when the file is opened again.
"""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, final

from ..._arguments import true_or_false
from ...errors import RecordingError
from ...io import damage_as_recording_error, is_session, lock, read_metadata, unlock
from ...rig import Rig
from ..protocol._clock import Clock, SystemClock, seconds
from ..protocol._message_counts import Counted, Counters
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
    Stream,
)
from ._tables import create_estimates, create_tables, mark, metadata_of, versions


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


# The end of a driven run whose program was killed before it could write one.
END_OF_ABORTED_RUN = {
    "status": "aborted",
    "kind": "aborted",
    "reason": "the program ended without a stop of its own; only the device can have switched off",
    "off": False,
    "tripped": False,
}


def end_aborted_runs(database: sqlite3.Connection, run: int, arrival: int) -> None:
    """Adds a stop document for each start that has none, inside the caller's transaction.

    **Arguments:**

    - `run`: the run of the recorder that has found them.
    - `arrival`: the time of the documents, ns.
    """
    database.execute(
        "INSERT INTO documents SELECT NULL, ?, ?, 'stop', uid, ? FROM documents AS begun "
        "WHERE kind = 'start' AND NOT EXISTS "
        "(SELECT 1 FROM documents WHERE kind = 'stop' AND uid = begun.uid) ORDER BY id",
        (run, arrival, json.dumps(END_OF_ABORTED_RUN)),
    )


def counted_in(database: sqlite3.Connection) -> dict[str, dict[str, dict[Stream, Counted]]]:
    """Returns the last messages in a recording: link -> start of a device -> stream ->
    `Counted`."""
    result: dict[str, dict[str, dict[Stream, Counted]]] = {}
    starts = "SELECT link, boot, max(id), min(arrival), max(hello) FROM greetings GROUP BY 1, 2"
    for link, boot, _, first, hello in database.execute(f"{starts} ORDER BY 3").fetchall():
        streams: dict[Stream, Counted] = {}
        own = "greeting IN (SELECT id FROM greetings WHERE link = ? AND boot = ?)"
        tables: list[tuple[Stream, str, str, tuple[object, ...]]] = [
            ("data", "samples", own, (link, boot)),
            ("event", "events", "link = ? AND arrival >= ? AND seq IS NOT NULL", (link, first)),
        ]
        if json.loads(hello)["camera"] is not None:
            tables.append(("image", "readings", own, (link, boot)))
        for stream, table, where, values in tables:
            last = database.execute(
                f"SELECT seq, device_us FROM {table} WHERE {where} ORDER BY id DESC LIMIT 1", values
            ).fetchone()
            if last is not None:
                streams[stream] = Counted((last[0] + 1) % 2**32, last[1])
        result.setdefault(link, {})[boot] = streams
    return result


# The sync window: newer records may be lost in a power failure.
SYNC_SECONDS = 1.0

# The interval at which the difference between the system's clock and the recording's is noted.
COMPARE_SECONDS = 600.0

# If the host's clock was set back, a run begins this time after the end of the earlier run, ns, so
# that the order of times in a recording is the order of runs.
BETWEEN_RUNS = 10**9

# A step of the system's clock by more than this, or a suspend, is noted at once.
STEP_SECONDS = 1.0

WAL_BYTES = 64 * 2**20  # to which the journal shrinks again after a long reader held it

_NTP = {True: ", kept by NTP", False: ", not kept by NTP", None: ""}

# The size of the journal at which it is copied into the file: SQLite's default, 1000 pages (4 MB).
_CHECKPOINT_PAGES = 1000


@final
class Recorder:
    """Writes a recording. Close it, or use it as a context manager.

    **Arguments:**

    - `file`: the recording. An existing file is refused unless `append` is set.
    - `rig`: the rig that is recorded.
    - `append`: whether a recording of the same rig is continued; the time in between is recorded as
      a gap, and a driven run whose program was killed gets its end, `aborted`.
    - `keep_frames`: whether camera frames are kept as well as the channels taken from them.
    - `clock`: host time.

    **Raises:** `RecordingError` if the file exists, belongs to another rig, is being recorded
    into, or cannot be written, and for an invalid argument.
    """

    def __init__(
        self,
        file: str | Path,
        rig: Rig,
        *,
        append: bool = False,
        keep_frames: bool = False,
        clock: Clock | None = None,
    ):
        for name, value in (("append", append), ("keep_frames", keep_frames)):
            true_or_false(f"Recorder: {name}", value, RecordingError)
        self.file = Path(file)
        self.written = 0
        """The number of records written so far."""
        self._clock: Clock = clock or SystemClock()
        self._synced = self._compared = self._apart = 0
        self._kept: bool | None = None
        self._ended = False
        metadata = metadata_of(rig)
        existed = self.file.exists()
        if existed and not append:
            raise RecordingError(
                f"{self.file}: expected a new file, got an existing one; append to it, or name "
                "another"
            )
        if existed and not is_session(self.file):  # looked at before SQLite touches it
            raise RecordingError(
                f"{self.file}: expected a recording of a live rig, got another file, which is "
                "unchanged"
            )
        self._shift = 0  # ns, from the clock's time to the recording's
        self._lock = lock(self.file)
        try:
            # The thread that polls a rig may be another one than that which made the recorder.
            self._database = sqlite3.connect(
                self.file, isolation_level=None, check_same_thread=False
            )
        except sqlite3.Error as error:
            unlock(self._lock)
            self._ended = True
            raise self._failure(error) from None
        try:
            if not existed:
                mark(self._database)
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.execute(f"PRAGMA journal_size_limit = {WAL_BYTES}")
            self._database.execute(f"PRAGMA wal_autocheckpoint = {_CHECKPOINT_PAGES}")
            self._counted: dict[str, Counters] = {}
            if existed:
                self._check_rig(metadata)
                with damage_as_recording_error(self.file):
                    self._counted.update(counted_in(self._database))
            self._run = self._begin(None if existed else metadata)
            self._rows = RowWriter(
                self._database, self._run, self._shift, len(rig.driven), keep_frames=keep_frames
            )
            self._identity = self._on_disk()
        except RecordingError:
            self._give_up()
            raise
        except sqlite3.Error as error:
            self._give_up()
            raise self._failure(error) from None
        except UnicodeDecodeError:  # SQLite quotes a damaged name in its own message
            self._give_up()
            raise RecordingError(f"{self.file}: is damaged: its schema is no text") from None

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close("stopped" if kind is None else kind.__name__)

    def counted(self, link: str) -> Counters:
        """Returns the last messages of the devices of a link that were recorded before this run, so
        that repeated messages are not recorded again and messages lost meanwhile are a gap."""
        return self._counted.get(link, {})

    def write(self, records: Sequence[Record]) -> None:
        """Writes records. Once it returns, they survive the death of this process.

        Without records it only syncs to the disk when this is due, so call it regularly.

        **Raises:** `RecordingError` if the disk is full or fails, or the file was moved or deleted.
        Then none of these records is kept, all earlier ones are, and the recorder is closed.
        """
        if self._ended:
            raise RecordingError(f"{self.file}: the recording is closed")
        if self._on_disk() != self._identity:
            self._give_up()
            raise RecordingError(
                f"{self.file}: was moved or deleted while it was recorded into; recording stopped "
                f"after {self.written} records"
            )
        now = self._clock.now()
        sync = seconds(now - self._synced) >= SYNC_SECONDS
        if not records and not sync:
            return
        apart = self._clock.utc() - now
        stepped = abs(seconds(apart - self._apart)) > STEP_SECONDS  # set by hand, or a suspend
        kept = self._clock.is_synchronised() if sync else self._kept
        if stepped or kept != self._kept or seconds(now - self._compared) >= COMPARE_SECONDS:
            detail = f"system clock {seconds(apart):+.6f} s{_NTP[kept]}"
            records = [*records, Event("", now, "host-clock", detail)]
            self._compared, self._apart, self._kept = now, apart, kept
        try:
            self._transact(records, now if sync else None)
        except sqlite3.Error as error:
            failure = self._failure(error)
            self._give_up()
            raise failure from None
        if sync:
            self._synced = now
        self.written += len(records)

    def close(self, reason: str = "stopped") -> None:
        """Ends the recording; `reason` is kept in it. A second call does nothing."""
        if self._ended:
            return
        try:
            end = Event("", self._clock.now(), "recording-end", reason)
            self._transact([end], end.arrival, ended=reason)
        except sqlite3.Error as error:
            raise self._failure(error) from None
        finally:
            self._give_up()

    def _transact(
        self, records: Sequence[Record], sync: int | None, ended: str | None = None
    ) -> None:
        execute = self._database.execute
        if sync is not None:
            execute("PRAGMA synchronous = FULL")
        execute("BEGIN IMMEDIATE")
        try:
            for record in records:
                self._rows.insert(record)
            if sync is not None:
                sync += self._shift
                # A transaction that changes nothing would not be forced onto the disk.
                execute(
                    "UPDATE runs SET alive = ?, alive_utc = ?, ended = ? WHERE id = ?",
                    (sync, self._clock.utc(), ended, self._run),
                )
            execute("COMMIT")
        except BaseException:
            # A full disk may have rolled back already.
            if self._database.in_transaction:
                execute("ROLLBACK")
            raise
        finally:
            if sync is not None:
                execute("PRAGMA synchronous = NORMAL")

    def _check_rig(self, metadata: dict[str, Any]) -> None:
        result = read_metadata(self._database, self.file)
        for field in ("rig", "cells", "channels", "camera", "counts", "polarity"):
            wanted = json.loads(json.dumps(metadata[field]))
            if result.get(field) != wanted:
                raise RecordingError(
                    f"{self.file}: {field}: expected {wanted} as the rig has, got "
                    f"{result.get(field)}; record each rig into a file of its own"
                )

    def _begin(self, metadata: dict[str, Any] | None) -> int:
        """Creates the tables if they are missing, and begins a run."""
        execute = self._database.execute
        now = self._clock.now()
        execute("PRAGMA synchronous = FULL")
        execute("BEGIN IMMEDIATE")
        if metadata is not None:
            create_tables(self._database, metadata)
        before = execute("SELECT alive, ended FROM runs ORDER BY id DESC LIMIT 1").fetchone()
        if before is not None and now < before[0] + BETWEEN_RUNS:
            self._shift = before[0] + BETWEEN_RUNS - now
        began = now + self._shift
        run = execute(
            "INSERT INTO runs VALUES (NULL, ?, ?, ?, NULL, ?)",
            (began, began, self._clock.utc(), json.dumps(versions())),
        ).lastrowid
        assert run is not None
        if before is not None:
            alive, ended = before
            execute(
                "INSERT INTO events VALUES (NULL, ?, '', ?, NULL, NULL, ?, ?)",
                (run, began, *self._break(alive, ended, now)),
            )
            end_aborted_runs(self._database, run, began)
        execute("COMMIT")
        execute("PRAGMA synchronous = NORMAL")
        self._synced = self._compared = now
        self._apart = self._clock.utc() - now
        return run

    def _break(self, alive: int, ended: str | None, now: int) -> tuple[str, str]:
        """Kind and detail of the event that describes the time since the earlier run."""
        how = f"the run before {f'ended ({ended})' if ended else 'broke off'}"
        silent = seconds(now - alive)
        if not self._shift or silent >= 0:
            return "not-recorded", f"{how}; nothing was recorded for {silent:.1f} s"
        return "clock-step", (
            f"{how}; the host's clock stands {-silent:.1f} s before its end now, and all times of "
            f"this run are {seconds(self._shift):.1f} s later than the clock says"
        )

    def _on_disk(self) -> tuple[int, int] | None:
        """Returns the device and the inode of the file that now has the name of the recording; None
        if there is no such file."""
        try:
            status = self.file.stat()
        except OSError:
            return None
        return status.st_dev, status.st_ino

    def _give_up(self) -> None:
        self._ended = True
        self._database.close()
        unlock(self._lock)

    def _failure(self, error: sqlite3.Error) -> RecordingError:
        if getattr(error, "sqlite_errorname", "") == "SQLITE_FULL":
            return RecordingError(
                f"{self.file}: the disk is full; recording stopped after {self.written} records, "
                "which are kept and can be read"
            )
        return RecordingError(
            f"{self.file}: cannot be written ({error}); {self.written} records of this run were "
            "written before, and what the file held is not changed"
        )
