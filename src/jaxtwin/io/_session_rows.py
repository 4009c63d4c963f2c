"""The rows of a table of a recording, on the time axis of the rig and in blocks.

A part of a recording is found by the arrival of its rows, not by reading all of them, and no more
than a block of rows is in memory at a time.
"""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ..errors import RecordingError
from ._clock_map import ClockMap

# The number of rows that are in memory at a time.
ROWS_IN_MEMORY = 20_000

# The number of rows at each end of a table among which its first and last time are looked for:
# devices send in turns.
END_ROWS = 1000

# The time by which a message may arrive later than the latest one to which a clock was fitted, s:
# rows that arrived later are not looked for in a part of a recording.
MAX_LATENESS_SECONDS = 60.0


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
@dataclass(frozen=True)
class SessionTable:
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


@final
class TableRows:
    """Reads a table.

    **Arguments:**

    - `database`: the recording, opened. `file`: its path, for messages.
    - `table`: the table and its columns.
    - `clocks`: the clocks of its devices.

    **Raises:** `RecordingError` if the devices ran at different rates.
    """

    def __init__(
        self,
        database: sqlite3.Connection,
        file: Path,
        table: SessionTable,
        clocks: list[DeviceClock],
    ):
        self._database, self._table, self._clocks = database, table, clocks
        rates = {device.clock.rate for device in clocks}
        if len(rates) > 1:
            raise RecordingError(
                f"{file}: expected devices that ran at one rate, got {sorted(rates)} times real "
                "time"
            )
        self._rate = next(iter(rates), 1.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return self._table.columns

    def all(self) -> Series:
        """All rows, in the order of their times."""
        columns = self.columns
        blocks = list(self.blocks())
        time = np.concatenate([np.zeros(0), *(block.time for block in blocks)])
        values = [np.zeros((0, len(columns))), *(block.values for block in blocks)]
        run = np.concatenate([np.zeros(0, np.int64), *(block.run for block in blocks)])
        # Two starts of a device may overlap by their clocks' uncertainty.
        order = np.argsort(time, kind="stable")
        return Series(time[order], np.concatenate(values)[order], columns, run[order])

    def blocks(self, begin: float = -np.inf, end: float = np.inf) -> Iterator[Series]:
        """The rows of a part of the table in blocks, each in the order of its times.

        **Arguments:**

        - `begin`, `end`: the times of the rig between which rows are needed, s; some rows outside
          are yielded as well.
        """
        latest = (
            max((device.clock.wait[2] for device in self._clocks), default=0.0)
            + MAX_LATENESS_SECONDS
        )
        lowest = self._first_id((begin - 1.0) / self._rate)
        highest = self._first_id(end / self._rate + latest)
        query = self._table.query("id >= ? AND id < ?") + " ORDER BY id"
        # A cursor of its own, since tables may be read in turns.
        rows = sqlite3.Cursor(self._database).execute(query, (lowest, highest))
        while part := rows.fetchmany(ROWS_IN_MEMORY):
            yield self._timed(np.array(part, np.float64))

    def ends(self) -> tuple[float, float] | None:
        """The first and the last time, s; None if the table has no rows."""
        first, last = self._end("ASC").time, self._end("DESC").time
        return (float(first.min()), float(last.max())) if len(first) else None

    def usual_interval(self) -> float:
        """The median interval between the first rows, s; 0 if there are none."""
        first = self._end("ASC").time
        return float(np.median(np.diff(first))) if len(first) > 1 else 0.0

    def longest_gap(self) -> tuple[float, float]:
        """The times between which there is no row for longest, s."""
        longest, last = (0.0, 0.0, 0.0), None
        for block in self.blocks():
            time = block.time if last is None else np.append(last, block.time)
            last = time[-1]
            if len(time) > 1:
                place = int(np.argmax(np.diff(time)))
                longest = max(longest, (time[place + 1] - time[place], *time[place : place + 2]))
        return longest[1:]

    def _end(self, order: str) -> Series:
        query = f"{self._table.query()} ORDER BY id {order} LIMIT {END_ROWS}"
        rows = self._database.execute(query).fetchall()
        return self._timed(np.array(rows, np.float64))

    def _first_id(self, host_seconds: float) -> int:
        """The number of the first row that arrived at or after a time, s since 1970. Rows arrive in
        the order of their numbers."""
        name, execute = self._table.name, self._database.execute
        low = 1
        (high,) = execute(f"SELECT coalesce(max(id), 0) + 1 FROM {name}").fetchone()
        while low < high:
            middle = (low + high) // 2
            number, arrival = execute(
                f"SELECT id, arrival FROM {name} WHERE id >= ? ORDER BY id LIMIT 1", (middle,)
            ).fetchone()
            if arrival * 1e-9 < host_seconds:
                low = number + 1
            else:
                high = middle
        return low

    def _timed(self, rows: Float[np.ndarray, "..."]) -> Series:
        """Rows of greeting, stamp and values with the times of the rig, in the order of these."""
        rows = rows.reshape(-1, 2 + len(self.columns))
        time, run = np.zeros(len(rows)), np.zeros(len(rows), np.int64)
        for device in self._clocks:
            own = np.isin(rows[:, 0], device.greetings)
            # Device time is below 2^53 us (285 years): exact as a float.
            stamps = rows[own, 1].astype(np.int64)
            time[own] = device.clock.host_seconds(stamps) * device.clock.rate
            run[own] = device.run
        order = np.argsort(time, kind="stable")
        return Series(time[order], rows[order, 2:], self.columns, run[order])
