"""Reads a recording of a live rig, while it is being written or afterwards."""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final
from urllib.parse import quote

import numpy as np
from jaxtyping import Bool, Float, Int

from .._arguments import finite_number
from .._errors import RecordingError
from ._clock_map import ClockMap
from ._experiment import Experiment
from ._lock import is_locked
from ._resample import BinMeans, ZeroOrderHold
from ._session_file import Columns, damage_as_recording_error, is_session, read_metadata

if TYPE_CHECKING:
    from ..rig import Rig

MOST_STAMPS = 100_000
"""The largest number of time stamps of a table to which a clock is fitted. Of a longer table, every
second, third, ... stamp is used."""

BLOCK = 20_000
"""The number of rows that are in memory at a time."""

END_ROWS = 1000
"""The number of rows at each end of a table among which its first and last time are looked for:
devices send in turns."""

BEFORE = 60.0
"""The time before a part of a recording in which its first duty is looked for, at least, s."""

LATEST = 60.0
"""The time by which a message may arrive later than the latest one to which a clock was fitted, s:
rows that arrived later are not looked for in a part of a recording."""

MOST_STEPS = 10_000_000
"""The largest number of steps of an experiment's grid: four months in seconds."""

LONGEST_HOLD = 3.0
"""The number of median intervals between controller samples for which a duty is assumed to be
held."""


@final
@dataclass(frozen=True, eq=False)
class Series:
    """A table of a recording, with all times on one axis.

    **Arguments:**

    - `time`: the time of the rig `(samples,)`, increasing, s; since 1970 if the rig runs in real
      time.
    - `values`: the values `(samples, columns)`.
    - `columns`: the names of the columns.
    - `run`: the number of the recorder's run to which each sample belongs.
    """

    time: Float[np.ndarray, " samples"]
    values: Float[np.ndarray, "samples columns"]
    columns: tuple[str, ...]
    run: Int[np.ndarray, " samples"]


@final
@dataclass(frozen=True, eq=False)
class DeviceClock:
    """One start of one device in one run of the recorder: its link, its boot, its numbers in
    `greetings`, and its clock."""

    run: int
    link: str
    boot: str
    greetings: tuple[int, ...]
    clock: ClockMap


@final
class Session:
    """A recording of a live rig. It can be read by any number of processes while it is written.

    Use it as a context manager, or close it.

    **Arguments:**

    - `file`: a file that a `Recorder` wrote.

    **Raises:** `RecordingError` if it is not a recording, or cannot be read.
    """

    def __init__(self, file: str | Path):
        self.file = Path(file)
        if not self.file.is_file():
            raise RecordingError(f"{self.file}: no such file")
        if not is_session(self.file):
            raise RecordingError(
                f"{self.file}: expected a recording of a live rig, got another file"
            )
        self.database = _open(self.file)
        try:
            self.metadata: dict[str, Any] = read_metadata(self.database, self.file)
        except BaseException:
            self.database.close()
            raise
        self._columns = Columns.of(self.metadata)

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self.database.close()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the temperature channels."""
        return tuple(self.metadata["channels"])

    @property
    def rig(self) -> "Rig":
        """The rig, from the text of its file at the time of the recording.

        **Raises:** `RigError` if this version of the program does not understand it.
        """
        from ..rig._build import build_rig  # with pydantic, which reading numbers does not need
        from ..rig._bundled import parse_toml

        source = f"{self.file}: rig file"
        return build_rig(parse_toml(self.metadata["rig_file"].encode(), source), source)

    def clocks(self) -> list[DeviceClock]:
        """The clock of each start of each device, in each run of the recorder.

        A device that lost its connection and came back without a restart has one clock.
        """
        with damage_as_recording_error(self.file):
            return self._clocks()

    def _clocks(self) -> list[DeviceClock]:
        execute = self.database.execute
        starts: dict[tuple[int, str, str, float], list[int]] = {}
        for number, run, link, boot, rate in execute(
            "SELECT id, run, link, boot, rate FROM greetings ORDER BY id"
        ):
            starts.setdefault((run, link, boot, rate), []).append(number)
        newest = [
            execute(f"SELECT coalesce(max(id), 0) FROM {table}").fetchone()[0]
            for table in ("samples", "readings")
        ]
        every = 1 + max(newest) // MOST_STAMPS
        clocks = []
        for (run, link, boot, rate), numbers in starts.items():
            which = f"WHERE greeting IN ({','.join('?' * len(numbers))})"
            # By their numbers, since a search through all rows would read the whole file.
            stamps = _array(
                execute(
                    "WITH RECURSIVE picked(id) AS (SELECT 1 UNION ALL "
                    f"SELECT id + {every} FROM picked WHERE id + {every} <= {max(newest)}) "
                    f"SELECT device_us, arrival FROM picked JOIN samples USING (id) {which} "
                    "UNION ALL "
                    f"SELECT device_us, arrival FROM picked JOIN readings USING (id) {which} "
                    "ORDER BY 2",
                    (*numbers, *numbers),
                ),
                np.int64,
            )
            if len(stamps):
                clock = ClockMap.fit(stamps[:, 0], stamps[:, 1], rate)
                clocks.append(DeviceClock(run, link, boot, tuple(numbers), clock))
        return clocks

    def readings(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Temperatures, degC; those taken while the camera recalibrated itself are left out."""
        names = self._columns.temperatures
        return self._series("readings", names, "recalibrating = 0", clocks)

    def duty(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Duty cycles that the controller reported, -1 to 1, positive heats the plate."""
        counts = self._series("samples", self._columns.pwm, "", clocks)
        factor = self.metadata["polarity"] / self.metadata["counts"]
        cells = tuple(self.metadata["cells"])
        return Series(counts.time, counts.values * factor, cells, counts.run)

    def ambient(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Ambient temperature if the controller measures it, degC."""
        where = "ambient_degC IS NOT NULL"
        return self._series("samples", ("ambient_degC",), where, clocks)

    def experiment(
        self,
        *,
        step: float | int = 1.0,
        start: float | int | None = None,
        end: float | int | None = None,
    ) -> Experiment:
        """The recording on an even grid. No temperature is filled in.

        **Arguments:**

        - `step`: the step of the grid, s.
        - `start`, `end`: the ends of the part that is read, s from the first time at which both
          duty and temperatures are known; `None` leaves that end open.

        **Returns:**

        An `Experiment` whose time 0 is that first time.

        **Raises:** `RecordingError` if duty or temperatures are missing altogether.
        """
        step = finite_number("step", step, RecordingError)
        start, end = (
            None if at is None else finite_number(name, at, RecordingError)
            for name, at in (("start", start), ("end", end))
        )
        if step <= 0:
            raise RecordingError(f"step: expected a number above 0, in s, got {step:g}")
        with damage_as_recording_error(self.file):
            # One moment of a file that may be growing.
            self.database.execute("BEGIN")
            try:
                return self._experiment(step, start, end)
            finally:
                self.database.execute("COMMIT")

    def _experiment(self, step: float, start: float | None, end: float | None) -> Experiment:
        clocks = self.clocks()
        temperatures = _Table("readings", self._columns.temperatures, "recalibrating = 0")
        counts = _Table("samples", self._columns.pwm, "")
        room = _Table("samples", ("ambient_degC",), "ambient_degC IS NOT NULL")
        spans = [self._ends(table, clocks) for table in (temperatures, counts)]
        if None in spans:
            missing = "temperatures" if spans[1] else "controller samples"
            raise RecordingError(f"{self.file}: expected samples and a drive, got no {missing}")
        begin, until = np.array(spans, np.float64).T
        zero = begin.max()
        last = until.min() - zero
        first = 0.0 if start is None else start
        last = last if end is None else min(end, last)
        if last <= first:
            raise RecordingError(
                f"{self.file}: expected samples from {first:g} s to {last:g} s, got none"
            )
        if (last - first) / step > MOST_STEPS:
            gap = self._longest_gap(temperatures, clocks, zero)
            raise RecordingError(
                f"{self.file}: expected at most {MOST_STEPS:g} steps of {step:g} s, got "
                f"{(last - first) / step:.2g} from {first:g} s to {last:g} s; take a part with "
                f"start and end: {gap}"
            )
        grid = zero + first + step * np.arange(int((last - first) / step + 1e-9) + 1)
        drive, there = self._held(counts, clocks, grid + step / 2, step)
        means = self._means(temperatures, clocks, grid, step)
        surroundings: Any = self._means(room, clocks, grid, step)[there, 0]
        if np.isnan(surroundings).all():
            surroundings = None
        if not there.all():
            grid, drive, means = grid[there], drive[there], means[there]
        try:
            return Experiment(
                grid - zero,
                drive,
                channels=self.channels,
                temperatures=means,
                ambient=surroundings,
                name=self.file.stem,
            )
        except RecordingError as error:
            raise RecordingError(f"{self.file}: {error}") from None

    def _means(
        self,
        table: "_Table",
        clocks: list[DeviceClock],
        grid: Float[np.ndarray, " grid"],
        step: float,
    ) -> Float[np.ndarray, "grid columns"]:
        means = BinMeans(grid, step, len(table.columns))
        for block in self._blocks(table, clocks, grid[0] - step, grid[-1] + step):
            means.add(block.time, block.values, block.run)
        return means.result()

    def _held(
        self,
        table: "_Table",
        clocks: list[DeviceClock],
        when: Float[np.ndarray, " grid"],
        step: float,
    ) -> tuple[Float[np.ndarray, "grid cells"], Bool[np.ndarray, " grid"]]:
        """The duty that was applied at each time, and whether there was one."""
        held = ZeroOrderHold(when, len(table.columns))
        intervals: list[float] = []
        factor = self.metadata["polarity"] / self.metadata["counts"]
        rows = self.database.execute(f"{table.query()} ORDER BY id LIMIT {END_ROWS}")
        first = _mapped(_array(rows, np.float64), table.columns, clocks)
        usual = float(np.median(np.diff(first.time))) if len(first.time) > 1 else 0.0
        begin = when[0] - max(BEFORE, 10 * LONGEST_HOLD * usual)
        for block in self._blocks(table, clocks, begin, when[-1]):
            held.add(block.time, block.values * factor)
            if len(block.time) > 1:
                intervals.append(float(np.median(np.diff(block.time))))
        return held.result(max(step, LONGEST_HOLD * float(np.median(intervals or [0.0]))))

    def _series(
        self, table: str, columns: tuple[str, ...], where: str, clocks: list[DeviceClock] | None
    ) -> Series:
        known = self.clocks() if clocks is None else clocks
        with damage_as_recording_error(self.file):
            blocks = list(self._blocks(_Table(table, columns, where), known))
        time = np.concatenate([np.zeros(0), *(block.time for block in blocks)])
        values = [np.zeros((0, len(columns))), *(block.values for block in blocks)]
        run = np.concatenate([np.zeros(0, np.int64), *(block.run for block in blocks)])
        # Two starts of a device may overlap by their clocks' uncertainty.
        order = np.argsort(time, kind="stable")
        return Series(time[order], np.concatenate(values)[order], columns, run[order])

    def _blocks(
        self,
        table: "_Table",
        clocks: list[DeviceClock],
        begin: float = -np.inf,
        end: float = np.inf,
    ) -> Iterator[Series]:
        """The rows of a part of a table in blocks, each in the order of its times.

        **Arguments:**

        - `begin`, `end`: the times of the rig between which rows are needed, s; some rows outside
          are yielded as well.
        """
        rates = {device.clock.rate for device in clocks}
        if len(rates) > 1:
            raise RecordingError(
                f"{self.file}: expected devices that ran at one rate, got {sorted(rates)} times "
                "real time"
            )
        if not rates:
            return
        (rate,) = rates
        latest = max(device.clock.wait[2] for device in clocks) + LATEST
        lowest = self._first_id(table.name, (begin - 1.0) / rate)
        highest = self._first_id(table.name, end / rate + latest)
        rows = sqlite3.Cursor(self.database).execute(
            table.query("id >= ? AND id < ?") + " ORDER BY id", (lowest, highest)
        )
        while part := rows.fetchmany(BLOCK):
            yield _mapped(np.array(part, np.float64), table.columns, clocks)

    def _first_id(self, table: str, host_seconds: float) -> int:
        """The number of the first row of a table that arrived at or after a time, s since 1970.
        Rows arrive in the order of their numbers."""
        low, high = (
            1,
            self.database.execute(f"SELECT coalesce(max(id), 0) + 1 FROM {table}").fetchone()[0],
        )
        while low < high:
            middle = (low + high) // 2
            row = self.database.execute(
                f"SELECT id, arrival FROM {table} WHERE id >= ? ORDER BY id LIMIT 1", (middle,)
            ).fetchone()
            if row[1] * 1e-9 < host_seconds:
                low = row[0] + 1
            else:
                high = middle
        return low

    def _ends(self, table: "_Table", clocks: list[DeviceClock]) -> tuple[float, float] | None:
        """The first and the last time of a table, s; None if it has no rows."""
        found = []
        for order in ("ASC", "DESC"):
            rows = self.database.execute(f"{table.query()} ORDER BY id {order} LIMIT {END_ROWS}")
            part = _mapped(_array(rows, np.float64), table.columns, clocks)
            if not len(part.time):
                return None
            found.append(part.time)
        return float(found[0].min()), float(found[1].max())

    def _longest_gap(self, table: "_Table", clocks: list[DeviceClock], zero: float) -> str:
        """Text on the longest time without a row."""
        longest, last = (0.0, 0.0, 0.0), None
        for block in self._blocks(table, clocks):
            time = block.time if last is None else np.append(last, block.time)
            place = int(np.argmax(np.diff(time))) if len(time) > 1 else 0
            if len(time) > 1:
                longest = max(longest, (time[place + 1] - time[place], *time[place : place + 2]))
            last = time[-1]
        return f"nothing was recorded from {longest[1] - zero:g} s to {longest[2] - zero:g} s"


@final
@dataclass(frozen=True)
class _Table:
    """A table of which some columns are read.

    - `where`: a condition on its rows; empty for all.
    """

    name: str
    columns: tuple[str, ...]
    where: str

    def query(self, condition: str = "") -> str:
        """The statement that selects device, stamp and columns."""
        names = ", ".join(f'"{name}"' for name in self.columns)
        where = " AND ".join(part for part in (self.where, condition) if part)
        return f"SELECT greeting, device_us, {names} FROM {self.name}" + (
            f" WHERE {where}" if where else ""
        )


def _mapped(
    rows: Float[np.ndarray, "samples fields"],
    columns: tuple[str, ...],
    clocks: list[DeviceClock],
) -> Series:
    """Rows of greeting, stamp and values with the times of the rig, in the order of these."""
    rows = rows.reshape(-1, 2 + len(columns))
    time, run = np.zeros(len(rows)), np.zeros(len(rows), np.int64)
    for device in clocks:
        own = np.isin(rows[:, 0], device.greetings)
        # Device time is below 2^53 us (285 years): exact as a float.
        stamps = rows[own, 1].astype(np.int64)
        time[own] = device.clock.host_seconds(stamps) * device.clock.rate
        run[own] = device.run
    order = np.argsort(time, kind="stable")
    return Series(time[order], rows[order, 2:], columns, run[order])


def _array(rows: sqlite3.Cursor, kind: type) -> np.ndarray:
    """Reads all rows as arrays, without keeping them as Python objects, which take ten times the
    memory."""
    parts = [np.zeros((0, len(rows.description)), kind)]
    while part := rows.fetchmany(20_000):
        parts.append(np.array(part, kind))
    return np.concatenate(parts)


def _open(file: Path) -> sqlite3.Connection:
    """Opens the file for reading, so that a recorder never waits and no row can be changed.

    If a reader with write access is the last to close the file, SQLite removes the journal and its
    index. This must not happen while a recorder uses the file; the lock shows whether one does.
    """
    attempts = [("mode=ro", "NORMAL")]
    if not is_locked(file):
        # The index needs room beside the file. A full disk denies that: it is kept in memory then.
        attempts = [("mode=rw", "NORMAL"), ("mode=rw", "EXCLUSIVE")]
        if not file.with_name(file.name + "-wal").exists():
            # Without a journal no index is needed, as on a write-protected disk.
            attempts.append(("mode=ro&immutable=1", "NORMAL"))
    problem = ""
    for access, locking in attempts:
        try:
            return _connect(file, access, locking)
        except sqlite3.DatabaseError as error:
            problem = problem or str(error)
    raise RecordingError(f"{file}: cannot be read: {problem}")


def _connect(file: Path, access: str, locking: str) -> sqlite3.Connection:
    location = f"file:{quote(str(file.absolute()))}?{access}"
    database = sqlite3.connect(location, uri=True, isolation_level=None)
    try:
        database.execute("PRAGMA query_only = ON")
        database.execute(f"PRAGMA locking_mode = {locking}")
        database.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except sqlite3.DatabaseError:
        database.close()
        raise
    except UnicodeDecodeError:  # SQLite quotes a damaged name in its own message
        database.close()
        raise sqlite3.DatabaseError("its schema is damaged") from None
    return database
