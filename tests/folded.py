"""Records by hand for what watches a rig: folded into the state, as the service does it."""

from collections.abc import Sequence

from jaxtwin.live import (
    AbstractInterlock,
    Finding,
    Record,
    RecordConsumer,
    RigState,
)


class Watched:
    """An interlock with the state of its rig."""

    def __init__(self, lock: AbstractInterlock, *before: Record):
        self._lock, self.state = lock, RigState()
        for record in before:
            self.on_record(record)

    def on_record(self, record: Record) -> Finding | None:
        self.state = self.state.after(record)
        return self._lock.on_record(record, self.state)

    def on_time(self, now: int) -> Finding | None:
        return self._lock.on_time(self.state, now)

    def before_start(self) -> Finding | None:
        return self._lock.before_start(self.state)


def feed(
    consumer: RecordConsumer, records: Sequence[Record], now: int, state: RigState
) -> RigState:
    """Hands records to a consumer as a turn of the service does. Returns the state after them."""
    for record in records:
        state = state.after(record)
        consumer.on_record(record, state)
    consumer.on_time(state, now)
    return state
