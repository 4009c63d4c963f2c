"""A view of a bench: the records that a reader has not taken yet."""

from collections import deque
from collections.abc import Sequence
from typing import final

from ._records import Record


@final
class View:
    """The records that a reader has not taken yet.

    A reader that is too slow loses the oldest records of its view. The journal never waits for it.
    """

    def __init__(self, capacity: int):
        self._waiting: deque[Record] = deque(maxlen=capacity)
        self.dropped = 0

    def put(self, records: Sequence[Record]) -> None:
        """Adds records. The bench calls it after it has written them to the journal."""
        room = (self._waiting.maxlen or 0) - len(self._waiting)
        self.dropped += max(0, len(records) - room)
        self._waiting.extend(records)

    def take(self) -> list[Record]:
        """Returns all waiting records, the oldest first. It may be called from another thread."""
        records: list[Record] = []
        while self._waiting:
            try:
                records.append(self._waiting.popleft())
            except IndexError:  # the bench dropped it in between
                break
        return records
