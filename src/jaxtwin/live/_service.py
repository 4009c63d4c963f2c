"""The loop around a rig: poll a source, fold its records, hand them to all that watch."""

from collections.abc import Callable, Sequence
from typing import Protocol, final, runtime_checkable

from .protocol._clock import Clock
from .protocol._records import Record
from .protocol._rig_state import RigState


@runtime_checkable
class RecordSource(Protocol):
    """Where records come from: a live rig (`RigConnection`), a recording (`Replay`), or a virtual
    rig in this process (`RigConnection` with an `InProcess` link)."""

    clock: Clock

    @property
    def ended(self) -> bool:
        """Whether no more records will come."""
        ...

    def poll(self, timeout: float | int = 0.1) -> list[Record]:
        """Returns the records since the last call, after waiting for at most `timeout` seconds."""
        ...


@runtime_checkable
class RecordConsumer(Protocol):
    """What watches a rig: a guard, a twin, alarms, a publisher, a screen, a page."""

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known of the rig after it."""
        ...

    def on_time(self, state: RigState, now: int) -> None:
        """Called after each poll, at host time `now`, ns: also if no record came."""
        ...


@final
class Service:
    """Polls a source, and hands each record, with what is known of the rig after it, to consumers.

    The source keeps the records in its journal first: a consumer that fails ends the loop, and
    nothing that was read is lost.

    **Arguments:**

    - `source`: where the records come from.
    - `consumers`: who gets them, in this order.
    """

    def __init__(self, source: RecordSource, consumers: Sequence[RecordConsumer] = ()):
        self.source = source
        self.state = RigState()
        """What is known of the rig."""
        self._consumers = tuple(consumers)

    def turn(self, timeout: float | int = 0.1) -> list[Record]:
        """Polls once.

        **Returns:** the records, after all consumers have had them.

        **Raises:** the errors of the source's journal and of the consumers.
        """
        records = self.source.poll(timeout)
        self.take(records)
        return records

    def take(self, records: Sequence[Record]) -> None:
        """Folds records that are there already, and hands them to the consumers."""
        for record in records:
            self.state = self.state.after(record)
            for consumer in self._consumers:
                consumer.on_record(record, self.state)
        now = self.source.clock.now()
        for consumer in self._consumers:
            consumer.on_time(self.state, now)

    def run(self, until: Callable[[], bool]) -> None:
        """Polls until the source ends, or `until` says so between two polls."""
        while not (self.source.ended or until()):
            self.turn()
