"""Keeps in a recording what an observer estimates, beside what was measured."""

from collections.abc import Callable
from typing import final

from ..observers import ExtendedKalmanFilter, Moment, state_moments
from ..physics import Twin
from ._follower import Follower
from .protocol._records import Reading, Record, StateEstimate
from .protocol._rig_state import RigState

# The shortest time between two estimates that are kept, ns.
MIN_INTERVAL_NS = 10**9


@final
class EstimateJournal:
    """Notes what an observer estimates after a reading, at most once a second. It consumes the
    records of a source after the follower.

    **Arguments:**

    - `note`: takes the record for the journal, such as `RigConnection.note`.
    - `followed`: the follower, with an extended Kalman filter, and what its twin is called. It may
      change.
    """

    def __init__(
        self, note: Callable[[Record], None], followed: Callable[[], tuple[Follower, str]]
    ):
        self._note, self._followed = note, followed
        self._reading: Reading | None = None
        self._noted = 0

    def on_record(self, record: Record, state: RigState) -> None:
        """Does nothing: the estimate is made when all records that arrived together are folded."""

    def on_time(self, state: RigState, now: int) -> None:
        """Notes the estimate after a new reading."""
        if state.reading is self._reading or now - self._noted < MIN_INTERVAL_NS:
            return
        follower, twin = self._followed()
        observer = follower.observer
        if follower.measured is None or not isinstance(observer, ExtendedKalmanFilter):
            return
        self._reading, self._noted = state.reading, now
        values = estimated_values(observer, follower)
        self._note(StateEstimate(follower.time, twin, values))


def estimated_values(observer: ExtendedKalmanFilter, follower: Follower) -> dict[str, float]:
    """Name with unit -> estimate, and its standard deviation: of what the channels see without the
    errors of their readings, of the nodes beside the elements of a plate, of the room, and of the
    heat that the twin does not explain."""
    twin: Twin = observer.model.twin
    result = state_moments(observer, follower.state)
    first = twin.wiring.elements
    nodes = [node.name for node in twin.netlist.nodes][first:]
    values: dict[str, float] = {}

    def add(names: list[str], unit: str, spread: str, moment: Moment, start: int = 0) -> None:
        for place, name in enumerate(names, start):
            values[f"{name}_{unit}"] = float(moment.mean[place])
            values[f"{name}_spread_{spread}"] = float(moment.spread[place])

    add([f"channel_{name}" for name in twin.channels], "degC", "K", result.channels)
    add([f"node_{name}" for name in nodes], "degC", "K", result.nodes, first)
    add(["room"], "degC", "K", result.room)
    add([f"heat_{name}" for name in twin.rig.driven], "W", "W", result.heats)
    return values
