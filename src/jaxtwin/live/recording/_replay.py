"""Replays a recording: the same records in the order of their arrival, at any speed."""

import heapq
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import final

from ...errors import RecordingError
from ...io import Session
from ...rig import Rig
from ..protocol._clock import Clock, SystemClock
from ..protocol._records import LinkChange, LinkState, Record
from ._row_reader import RowReader

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
