"""Reads a recording of a live rig, while it is being written or afterwards."""

import sqlite3
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, final
from urllib.parse import quote

import numpy as np
from jaxtyping import Bool, Float, Int

from .._arguments import finite_number
from ..errors import RecordingError
from ._experiment import Experiment
from ._session_file import Columns, damage_as_recording_error, is_locked, is_session, read_metadata
from ._session_rows import ClockMap, DeviceClock, Series, SessionTable, TableRows

if TYPE_CHECKING:
    from ..rig import Rig


def open_session(file: Path) -> sqlite3.Connection:
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
    # A replay may be read by another thread than that which opened it.
    database = sqlite3.connect(location, uri=True, isolation_level=None, check_same_thread=False)
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


# Transfers samples with times of their own to the common grid that an `Experiment` needs.
#
# No value is filled in. The rules are:
#
# - The grid is `start + k step`.
# - A temperature, or the ambient, is the mean of all readings within half a step of the grid
#   time, if these belong to a single run of the recorder.
# - The duty of a step is the duty that was applied in the middle of the step, so that the error
#   of a switch is half a step at most. A duty is applied from its sample until the next sample,
#   or until `longest` after it.
# - A temperature without a reading is a missing sample, and so is the ambient.
# - A grid time without a duty is left out; it is a gap.
#
# Samples are added in blocks, so that a recording of any length needs only the memory of its
# grid.

# The run of a bin without samples, and of one with samples of several runs.
NONE, MIXED = -1, -2


@final
class BinMeans:
    """The means within half a step of each grid time.

    **Arguments:**

    - `grid`: the grid times, evenly spaced by `step`, s.
    - `step`: the step of the grid, s.
    - `columns`: the number of columns of the values.
    """

    def __init__(self, grid: Float[np.ndarray, " grid"], step: float, columns: int):
        self._start, self._step = grid[0], step
        self._sums = np.zeros((len(grid), columns))
        self._counts = np.zeros((len(grid), columns), np.int32)
        self._runs = np.full(len(grid), NONE, np.int32)

    def add(
        self,
        time: Float[np.ndarray, " samples"],
        values: Float[np.ndarray, "samples columns"],
        run: Int[np.ndarray, " samples"],
    ) -> None:
        """Adds samples in any order.

        **Arguments:**

        - `time`: the times of the samples, s.
        - `values`: the values of the samples; NaN is left out.
        - `run`: the number of the run to which each sample belongs.
        """
        place = np.floor((time - self._start) / self._step + 0.5).astype(np.int64)
        inside = (place >= 0) & (place < len(self._sums))
        place, values, run = place[inside], values[inside], run[inside]
        if not len(place):
            return
        first, length = place.min(), np.ptp(place) + 1
        part = slice(first, first + length)
        there = ~np.isnan(values)
        for column in range(values.shape[1]):
            weights = np.where(there[:, column], values[:, column], 0.0)
            solution = there[:, column].astype(np.float64)
            self._sums[part, column] += np.bincount(place - first, weights, length)
            counts = np.bincount(place - first, solution, length)
            self._counts[part, column] += counts.astype(np.int32)
        for number in np.unique(run):
            bins = place[(run == number) & there.any(axis=1)]
            before = self._runs[bins]
            self._runs[bins] = np.where((before == NONE) | (before == number), number, MIXED)

    def result(self) -> Float[np.ndarray, "grid columns"]:
        """The means; NaN for bins without samples, or with samples of several runs. It is made in
        the place of the sums, and can be taken once."""
        with np.errstate(invalid="ignore"):  # 0 / 0 is NaN
            np.divide(self._sums, self._counts, out=self._sums)
        self._sums[self._runs == MIXED] = np.nan
        return self._sums


@final
class ZeroOrderHold:
    """The last value at or before each of several times.

    **Arguments:**

    - `when`: the requested times, increasing, s.
    - `columns`: the number of columns of the values.
    """

    def __init__(self, when: Float[np.ndarray, " grid"], columns: int):
        self._when = when
        self._time = np.full(len(when), -np.inf)
        self._values = np.zeros((len(when), columns))

    def add(
        self, time: Float[np.ndarray, " samples"], values: Float[np.ndarray, "samples columns"]
    ) -> None:
        """Adds samples in increasing order of their times (s), beginning before or after those that
        were added already."""
        # The last sample before each requested time, if it is later than what was found before.
        place = np.searchsorted(self._when, time, side="left")
        last = np.append(place[1:] != place[:-1], True)
        place, time, values = place[last], time[last], values[last]
        later = place < len(self._when)
        later[later] = time[later] > self._time[place[later]]
        self._time[place[later]] = time[later]
        self._values[place[later]] = values[later]

    def result(
        self, longest: float
    ) -> tuple[Float[np.ndarray, "grid columns"], Bool[np.ndarray, " grid"]]:
        """The values, and whether each is at most `longest` seconds old."""
        solution = np.where(np.isfinite(self._time), np.arange(len(self._time)), 0)
        last = np.maximum.accumulate(solution)
        age = self._when - self._time[last]
        return self._values[last], age <= longest


# The largest number of time stamps of a table to which a clock is fitted. Of a longer table, every
# second, third, ... stamp is used.
MAX_STAMPS = 100_000

# The time before a part of a recording in which its first duty is looked for, at least, s.
LOOKBACK_SECONDS = 60.0

# The largest number of steps of an experiment's grid: four months in seconds.
MAX_STEPS = 10_000_000

# The number of median intervals between controller samples for which a duty is assumed to be held.
MAX_HOLD = 3.0


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
        self.database = open_session(self.file)
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
        from ..rig import parse_rig  # with pydantic, which reading numbers does not need

        return parse_rig(self.metadata["rig_file"].encode(), f"{self.file}: rig file")

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
        every = 1 + max(newest) // MAX_STAMPS
        clocks = []
        for (run, link, boot, rate), numbers in starts.items():
            which = f"WHERE greeting IN ({','.join('?' * len(numbers))})"
            # By their numbers, since a search through all rows would read the whole file.
            stamps = np.array(
                execute(
                    "WITH RECURSIVE picked(id) AS (SELECT 1 UNION ALL "
                    f"SELECT id + {every} FROM picked WHERE id + {every} <= {max(newest)}) "
                    f"SELECT device_us, arrival FROM picked JOIN samples USING (id) {which} "
                    "UNION ALL "
                    f"SELECT device_us, arrival FROM picked JOIN readings USING (id) {which} "
                    "ORDER BY 2",
                    (*numbers, *numbers),
                ).fetchall(),
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
        counts = self._series("samples", self._columns.pwm, self._is_driven, clocks)
        factor = self.metadata["polarity"] / self.metadata["counts"]
        cells = tuple(self.metadata["cells"])
        return Series(counts.time, counts.values * factor, cells, counts.run)

    @property
    def _is_driven(self) -> str:
        """The condition for a sample of a device that drives cells; that of a camera has none."""
        return f'"{self._columns.pwm[0]}" IS NOT NULL'

    def ambient(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Ambient temperature if the controller measures it, degC."""
        where = "ambient_degC IS NOT NULL"
        return self._series("samples", ("ambient_degC",), where, clocks)

    def estimates(self, clocks: list[DeviceClock] | None = None) -> Series:
        """What an observer estimated while it was recorded, and its standard deviations, by names
        with units; without rows if none did."""
        known = self.clocks() if clocks is None else clocks
        rate = known[-1].clock.rate if known else 1.0
        with damage_as_recording_error(self.file):
            fields = self.database.execute("PRAGMA table_info(estimates)").fetchall()
            names = tuple(str(name) for _, name, *_ in fields)[4:]
            quoted = "".join(', "{}"'.format(name.replace('"', '""')) for name in names)
            query = f"SELECT arrival, run{quoted} FROM estimates ORDER BY id"
            rows = self.database.execute(query).fetchall() if names else []
            table = np.array(rows, np.float64).reshape(-1, 2 + len(names))
        return Series(table[:, 0] * 1e-9 * rate, table[:, 2:], names, table[:, 1].astype(np.int64))

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
        step = finite_number("step", step, RecordingError, above=0, unit="s")
        start, end = (
            None if at is None else finite_number(name, at, RecordingError)
            for name, at in (("start", start), ("end", end))
        )
        with damage_as_recording_error(self.file):
            # One moment of a file that may be growing.
            self.database.execute("BEGIN")
            try:
                return self._experiment(step, start, end)
            finally:
                self.database.execute("COMMIT")

    def _experiment(self, step: float, start: float | None, end: float | None) -> Experiment:
        clocks = self.clocks()
        names = self._columns.temperatures
        temperatures = self._rows("readings", names, "recalibrating = 0", clocks)
        counts = self._rows("samples", self._columns.pwm, self._is_driven, clocks)
        room = self._rows("samples", ("ambient_degC",), "ambient_degC IS NOT NULL", clocks)
        spans = [rows.ends() for rows in (temperatures, counts)]
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
        if (last - first) / step > MAX_STEPS:
            before, after = temperatures.longest_gap()
            raise RecordingError(
                f"{self.file}: expected at most {MAX_STEPS:g} steps of {step:g} s, got "
                f"{(last - first) / step:.2g} from {first:g} s to {last:g} s; take a part with "
                f"start and end: nothing was recorded from {before - zero:g} s to "
                f"{after - zero:g} s"
            )
        grid = zero + first + step * np.arange(int((last - first) / step + 1e-9) + 1)
        drive, there = self._held(counts, grid + step / 2, step)
        means = _means(temperatures, grid, step)
        surroundings: Any = _means(room, grid, step)[there, 0]
        if np.isnan(surroundings).all():
            surroundings = None
        if not there.all():
            grid, drive, means = grid[there], drive[there], means[there]
        try:
            return Experiment(
                grid - zero,
                drive,
                cells=self.metadata["cells"],
                channels=self.channels,
                temperatures=means,
                ambient=surroundings,
                name=self.file.stem,
                # A rig that is faster than time has no clock of its own.
                start=datetime.fromtimestamp(zero) if clocks[-1].clock.rate == 1.0 else None,
            )
        except RecordingError as error:
            raise RecordingError(f"{self.file}: {error}") from None

    def _rows(
        self, table: str, columns: tuple[str, ...], where: str, clocks: list[DeviceClock]
    ) -> TableRows:
        return TableRows(self.database, self.file, SessionTable(table, columns, where), clocks)

    def _series(
        self, table: str, columns: tuple[str, ...], where: str, clocks: list[DeviceClock] | None
    ) -> Series:
        known = self.clocks() if clocks is None else clocks
        with damage_as_recording_error(self.file):
            return self._rows(table, columns, where, known).all()

    def _held(
        self, counts: TableRows, when: Float[np.ndarray, " grid"], step: float
    ) -> tuple[Float[np.ndarray, "grid cells"], Bool[np.ndarray, " grid"]]:
        """The duty that was applied at each time, and whether there was one."""
        held = ZeroOrderHold(when, len(counts.columns))
        factor = self.metadata["polarity"] / self.metadata["counts"]
        begin = when[0] - max(LOOKBACK_SECONDS, 10 * MAX_HOLD * counts.usual_interval())
        intervals = [0.0]
        for block in counts.blocks(begin, when[-1]):
            held.add(block.time, block.values * factor)
            if len(block.time) > 1:
                intervals.append(float(np.median(np.diff(block.time))))
        usual = float(np.median(intervals[1:] or intervals))
        return held.result(max(step, MAX_HOLD * usual))


def _means(
    rows: TableRows, grid: Float[np.ndarray, " grid"], step: float
) -> Float[np.ndarray, "grid columns"]:
    means = BinMeans(grid, step, len(rows.columns))
    for block in rows.blocks(grid[0] - step, grid[-1] + step):
        means.add(block.time, block.values, block.run)
    return means.result()
