"""Reads a recording of a live rig, while it is being written or afterwards."""

import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final
from urllib.parse import quote

import numpy as np
from jaxtyping import Float, Int

from .._arguments import finite_number
from .._errors import RecordingError
from ._clock_map import ClockMap
from ._experiment import Experiment
from ._lock import is_locked
from ._resample import bin_means_by_run, zero_order_hold
from ._session_file import Columns, damage_as_recording_error, is_session, read_metadata

if TYPE_CHECKING:
    from ..rig import Rig

MOST_STAMPS = 1_000_000
"""The largest number of time stamps of a table to which a clock is fitted. Of a longer table, every
second, third, ... stamp is used."""

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
            which = f"WHERE greeting IN ({','.join('?' * len(numbers))}) AND id % {every} = 0"
            stamps = _array(
                execute(
                    f"SELECT device_us, arrival FROM samples {which} UNION ALL "
                    f"SELECT device_us, arrival FROM readings {which} ORDER BY 2",
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
        return self._series("readings", names, "WHERE recalibrating = 0", clocks)

    def duty(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Duty cycles that the controller reported, -1 to 1, positive heats the plate."""
        counts = self._series("samples", self._columns.pwm, "", clocks)
        factor = self.metadata["polarity"] / self.metadata["counts"]
        cells = tuple(self.metadata["cells"])
        return Series(counts.time, counts.values * factor, cells, counts.run)

    def ambient(self, clocks: list[DeviceClock] | None = None) -> Series:
        """Ambient temperature if the controller measures it, degC."""
        where = "WHERE ambient_degC IS NOT NULL"
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
        with damage_as_recording_error(self.file):
            # One moment of a file that may be growing.
            self.database.execute("BEGIN")
            try:
                clocks = self.clocks()
                readings, duty = self.readings(clocks), self.duty(clocks)
                ambient = self.ambient(clocks)
            finally:
                self.database.execute("COMMIT")
        if not len(readings.time) or not len(duty.time):
            missing = "temperatures" if len(duty.time) else "controller samples"
            raise RecordingError(f"{self.file}: expected samples and a drive, got no {missing}")
        if step <= 0:
            raise RecordingError(f"step: expected a number above 0, in s, got {step:g}")
        zero = max(readings.time[0], duty.time[0])
        last = min(readings.time[-1], duty.time[-1]) - zero
        first = 0.0 if start is None else start
        last = last if end is None else min(end, last)
        if last <= first:
            raise RecordingError(
                f"{self.file}: expected samples from {first:g} s to {last:g} s, got none"
            )
        if (last - first) / step > MOST_STEPS:
            raise RecordingError(
                f"{self.file}: expected at most {MOST_STEPS:g} steps of {step:g} s, got "
                f"{(last - first) / step:.2g} from {first:g} s to {last:g} s; take a part with "
                f"start and end: {_longest_gap(readings.time - zero)}"
            )
        grid = zero + first + step * np.arange(int((last - first) / step + 1e-9) + 1)

        means = bin_means_by_run(readings.time, readings.values, readings.run, grid, step)
        longest = max(step, LONGEST_HOLD * float(np.median(np.diff(duty.time))))
        drive, there = zero_order_hold(duty.time, duty.values, grid + step / 2, longest)
        surroundings: Any = None
        if len(ambient.time):
            surroundings = bin_means_by_run(ambient.time, ambient.values, ambient.run, grid, step)[
                there, 0
            ]
            if np.isnan(surroundings).all():
                surroundings = None
        try:
            return Experiment(
                (grid - zero)[there],
                drive[there],
                channels=self.channels,
                temperatures=means[there],
                ambient=surroundings,
                name=self.file.stem,
            )
        except RecordingError as error:
            raise RecordingError(f"{self.file}: {error}") from None

    def _series(
        self, table: str, columns: tuple[str, ...], where: str, clocks: list[DeviceClock] | None
    ) -> Series:
        names = ", ".join(f'"{name}"' for name in columns)
        with damage_as_recording_error(self.file):
            rows = self.database.execute(
                f"SELECT greeting, device_us, {names} FROM {table} {where}"
            )
            values = _array(rows, np.float64).reshape(-1, 2 + len(columns))
        time = np.zeros(len(values))
        run = np.zeros(len(values), np.int64)
        rates = set()
        for device in self.clocks() if clocks is None else clocks:
            own = np.isin(values[:, 0], device.greetings)
            # Device time is below 2^53 us (285 years): exact as a float.
            stamps = values[own, 1].astype(np.int64)
            time[own] = device.clock.host_seconds(stamps) * device.clock.rate
            run[own] = device.run
            rates.add(device.clock.rate)
        if len(rates) > 1:
            raise RecordingError(
                f"{self.file}: expected devices that ran at one rate, got {sorted(rates)} times "
                "real time"
            )
        # Two starts of a device may overlap by their clocks' uncertainty.
        order = np.argsort(time, kind="stable")
        return Series(time[order], values[order, 2:], columns, run[order])


def _longest_gap(time: Float[np.ndarray, " samples"]) -> str:
    """Text on the longest time without a record."""
    last = int(np.argmax(np.diff(time)))
    return f"nothing was recorded from {time[last]:g} s to {time[last + 1]:g} s"


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
