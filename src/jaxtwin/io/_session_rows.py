"""The rows of a table of a recording, in blocks, with the time of the device on that of the host.

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

# Maps device time to host time, by the offset, drift and jitter of a device's clock.
#
# A stamp $d$ of the device arrives at host time $a = m(d) + w$ after a wait $w$ that is never below
# the shortest one and has a long tail (buffers, scheduling). The fastest arrivals therefore show
# the clock, and the others the wait: $m$ passes through the earliest arrival of each block of time.
# The shortest wait itself cannot be determined from one side. It remains in $m$ and is well below a
# millisecond on USB and loopback.

BLOCKS = 8

# Limits of the length of a block, s. A block is an eighth of the recording within these limits, as
# the drift of a crystal changes within the hour.
SHORTEST_BLOCK, LONGEST_BLOCK = 10.0, 600.0


@final
@dataclass(frozen=True, eq=False)
class ClockMap:
    """A device's clock as seen from the host.

    **Arguments:**

    - `rate`: the nominal seconds of device time in a second of host time.
    - `device`, `offset`: knots `(knots,)`, s: host time is `device / rate + offset` there, and
        linear in between.
    - `drift`: the relative amount by which the device's clock is too fast, 1e-6 (ppm).
    - `wait`: the delay of the stamps after the mapped time: median, 99th percentile and maximum, s.
      This is the jitter.
    """

    rate: float
    device: Float[np.ndarray, " knots"]
    offset: Float[np.ndarray, " knots"]
    drift: float
    wait: tuple[float, float, float]

    @classmethod
    def fit(
        cls, device_us: Int[np.ndarray, " stamps"], arrival: Int[np.ndarray, " stamps"], rate: float
    ) -> "ClockMap":
        """Fits the map to stamps of one start of a device.

        **Arguments:**

        - `device_us`: device time, microseconds.
        - `arrival`: host time of the same messages, ns, in order.
        - `rate`: nominal seconds of device time in a second.
        """
        device = device_us * 1e-6
        # Differences of nanosecond integers first: float64 cannot hold 1e18 ns.
        start = int(arrival[0])
        host = (arrival - start) * 1e-9
        offset = host - device / rate
        span = float(host[-1]) or 1.0
        length = np.clip(span / BLOCKS, SHORTEST_BLOCK, LONGEST_BLOCK)
        # All blocks have the full length: a short one at the end may contain no fast arrival.
        blocks = max(1, int(span / length))
        block = np.minimum((host / span * blocks).astype(np.int64), blocks - 1)

        knots = _earliest(block, offset)
        slope = _slope(device[knots], offset[knots])
        # Within a block the drift itself moves the offset: the earliest is looked for without it.
        knots = _earliest(block, offset - slope * device)
        knots_device, knots_offset = device[knots], offset[knots]
        late = offset - _offsets(device, knots_device, knots_offset, slope)
        late -= late.min()
        wait = (float(np.median(late)), float(np.quantile(late, 0.99)), float(late.max()))
        drift = -slope * rate * 1e6
        return cls(rate, knots_device, knots_offset + start * 1e-9, drift, wait)

    def host_seconds(self, device_us: Int[np.ndarray, " stamps"]) -> Float[np.ndarray, " stamps"]:
        """Host time of device stamps, s since 1970 (float64 resolves 0.3 microseconds)."""
        device = device_us * 1e-6
        slope = -self.drift * 1e-6 / self.rate
        return device / self.rate + _offsets(device, self.device, self.offset, slope)


def _earliest(block: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Index of the smallest offset in each block, in order."""
    order = np.lexsort((offset, block))
    return np.sort(order[np.unique(block[order], return_index=True)[1]])


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """The Theil-Sen slope, the median over pairs of knots: blocks without a fast arrival hardly
    change it. Knots are thinned out to fewer than 400."""
    step = max(1, len(x) // 200)
    x, y = x[::step], y[::step]
    dx = x[:, None] - x[None, :]
    far = dx > 0
    if not far.any():
        return 0.0
    return float(np.median((y[:, None] - y[None, :])[far] / dx[far]))


def _offsets(
    device: np.ndarray, knots: np.ndarray, offsets: np.ndarray, slope: float
) -> np.ndarray:
    """Interpolates linearly between the knots, and extrapolates with the mean slope."""
    beyond = device - np.clip(device, knots[0], knots[-1])
    return np.interp(device, knots, offsets) + slope * beyond


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
