"""The recorder: records -> an SQLite file that survives what happens to the process and the power.

SQLite in WAL mode (https://sqlite.org/wal.html). Every call of `write` is one transaction, handed
to the operating system before it returns: a killed process loses nothing that was written. Once a
second a transaction is also forced onto the disk (`synchronous = FULL` for that one; it takes all
earlier ones with it): a power failure loses at most that second. A transaction that was torn in the
middle is dropped by SQLite when the file is opened again.
"""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, final

from .._errors import RecordingError
from ..io._lock import lock, unlock
from ..io._session_file import Columns, read_metadata
from ..rig import Rig
from ._records import (
    Command,
    Event,
    Gap,
    Greeting,
    LinkChange,
    Reading,
    Record,
    Sample,
)
from ._tables import create_tables, mark, metadata_of, versions
from ._time import Clock, SystemClock, seconds

SYNC_SECONDS = 1.0
"""The sync window: what is younger may be lost in a power failure."""

COMPARE_SECONDS = 600.0
"""How often is noted how far the system's clock and the recording's are apart."""

WAL_BYTES = 64 * 2**20  # to which the journal shrinks again after a long reader held it

# A number that no reader can hold back: SQLite's default is 1000 pages, 4 MB.
_CHECKPOINT_PAGES = 1000


@final
class Recorder:
    """A recording that is being written. Close it, or use it as a context manager.

    **Arguments:**

    - `file`: where to. A file that is there is refused unless `append` is set.
    - `rig`: whose records these are.
    - `append`: go on with a recording of the same rig; the time in between is a gap, noted as such.
    - `keep_frames`: keep camera frames as well as the channels taken from them.
    - `clock`: host time.

    **Raises:** `RecordingError` where the file exists, belongs to another rig, is being recorded
    into, or cannot be written.
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
        self.file = Path(file)
        self.written = 0
        """Records kept so far."""
        self._clock: Clock = clock or SystemClock()
        self._keep_frames = keep_frames
        self._greetings: dict[tuple[str, str], int] = {}
        self._synced = self._compared = 0
        self._ended = False
        metadata = metadata_of(rig)
        columns = Columns.of(metadata)
        self._pwm, self._temperatures = columns.pwm, columns.temperatures
        existed = self.file.exists()
        if existed and not append:
            raise RecordingError(f"{self.file}: is there already; append to it, or name another")
        self._lock = lock(self.file)
        try:
            self._database = sqlite3.connect(self.file, isolation_level=None)
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
            if existed:
                self._check_rig(metadata)
            self._run = self._begin(None if existed else metadata)
        except RecordingError:
            self._give_up()
            raise
        except sqlite3.Error as error:
            self._give_up()
            raise self._failure(error) from None

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close("stopped" if kind is None else kind.__name__)

    def write(self, records: Sequence[Record]) -> None:
        """Keeps records; when it returns, the death of this process cannot take them any more.

        With nothing to write it only sees to the sync, so call it regularly.

        **Raises:** `RecordingError` where the disk is full or fails. None of these records is kept
        then, all earlier ones are, and the recorder is closed.
        """
        if self._ended:
            raise RecordingError(f"{self.file}: the recording is closed")
        now = self._clock.now()
        sync = seconds(now - self._synced) >= SYNC_SECONDS
        if not records and not sync:
            return
        if seconds(now - self._compared) >= COMPARE_SECONDS:
            apart = seconds(self._clock.utc() - now)
            records = [*records, Event("", now, "host-clock", f"system clock {apart:+.6f} s")]
            self._compared = now
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
                self._insert(record)
            if sync is not None:
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

    def _insert(self, record: Record) -> None:
        match record:
            case Sample():
                device = self._device(record)
                self._row("samples", (None, *device, record.ambient, *record.pwm))
            case Reading():
                device = self._device(record)
                values = record.temperatures.tolist()
                row = self._row("readings", (None, *device, int(record.recalibrating), *values))
                if self._keep_frames and record.pixels is not None:
                    self._row("frames", (row, record.pixels.astype("<u2").tobytes()))
            case Greeting(link, arrival, hello):
                content = json.dumps(asdict(hello))
                row = (None, self._run, link, arrival, hello.boot, hello.rate, content)
                self._greetings[link, hello.boot] = self._row("greetings", row)
            case Gap(link, arrival, stream, first, count):
                self._row("gaps", (None, self._run, link, arrival, stream, first, count))
            case LinkChange(link, arrival, state, detail):
                self._row("events", (None, self._run, link, arrival, None, f"link-{state}", detail))
            case Event(link, arrival, kind, detail, device_us):
                self._row("events", (None, self._run, link, arrival, device_us, kind, detail))
            case Command(link, arrival, number, pwm):
                self._row("commands", (None, self._run, link, arrival, number, *pwm))

    def _device(self, record: Sample | Reading) -> tuple[int, int, int, int]:
        greeting = self._greetings[record.link, record.boot]
        return greeting, record.arrival, record.device_us, record.seq

    def _row(self, table: str, values: tuple[Any, ...]) -> int:
        marks = ",".join("?" * len(values))
        cursor = self._database.execute(f"INSERT INTO {table} VALUES ({marks})", values)
        return cursor.lastrowid or 0

    def _check_rig(self, metadata: dict[str, Any]) -> None:
        found = read_metadata(self._database, self.file)
        for field in ("rig", "cells", "channels", "camera", "counts", "polarity"):
            wanted = json.loads(json.dumps(metadata[field]))
            if found.get(field) != wanted:
                raise RecordingError(
                    f"{self.file}: holds {field} {found.get(field)}, the rig has {wanted}: "
                    "one recording holds one rig"
                )

    def _begin(self, metadata: dict[str, Any] | None) -> int:
        """Makes the tables where they are missing, and begins a run."""
        execute = self._database.execute
        now = self._clock.now()
        execute("PRAGMA synchronous = FULL")
        execute("BEGIN IMMEDIATE")
        if metadata is not None:
            create_tables(self._database, metadata)
        before = execute("SELECT alive, ended FROM runs ORDER BY id DESC LIMIT 1").fetchone()
        run = execute(
            "INSERT INTO runs VALUES (NULL, ?, ?, ?, NULL, ?)",
            (now, now, self._clock.utc(), json.dumps(versions())),
        ).lastrowid
        assert run is not None
        if before is not None:
            alive, ended = before
            how = f"ended ({ended})" if ended else "broke off"
            detail = f"the run before {how}; nothing was recorded for {seconds(now - alive):.1f} s"
            execute(
                "INSERT INTO events VALUES (NULL, ?, '', ?, NULL, 'not-recorded', ?)",
                (run, now, detail),
            )
        execute("COMMIT")
        execute("PRAGMA synchronous = NORMAL")
        self._synced = self._compared = now
        return run

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
            f"{self.file}: cannot be written ({error}); {self.written} records are kept"
        )
