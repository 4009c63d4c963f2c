"""Interlocks: each looks at what comes from a rig and says when the cells must go off.

They are pure: records, commands and the time go in, a trip comes out. `Guard` is all of them
together, and stands between a rig and whatever commands it.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, final, runtime_checkable

from ..physics import Twin
from ._obedience import Obedience
from ._operating_limits import OperatingLimits
from ._plausibility import Plausibility
from ._presence import Presence
from ._records import Record
from ._trip import Trip
from ._twin_watch import TwinWatch


@runtime_checkable
class Interlock(Protocol):
    """Looks at one kind of danger."""

    def see(self, record: Record) -> Trip | None:
        """Takes what came from the rig; the reason to stop, if there is any."""
        ...

    def check(self, now: int) -> Trip | None:
        """The same for what did not come, by host time `now`, ns."""
        ...


@final
class Guard:
    """Says when the cells must go off: all interlocks of a rig.

    **Arguments:**

    - `twin`: of the rig, whose file must state `limits.temperature`.
    - `owner`: in whose name the rig is commanded (`Bench.owner`).
    - `silence`: longest time without a controller sample, or without temperatures that count, s.

    **Raises:** `JaxtwinError` where the rig file states no limit.
    """

    def __init__(self, twin: Twin, owner: str, *, silence: float | int = 3.0):
        self.limits = OperatingLimits.of(twin)
        rig = twin.rig
        channels = tuple(channel.name for channel in rig.channels)
        cells = tuple(cell.name for cell in rig.cells)
        self._presence = Presence(float(silence))
        self._obedience = Obedience(owner, cells, self.limits.command_delay)
        self._readings = Plausibility(channels, self.limits)
        self._twin = TwinWatch(twin, self.limits)
        # The plainest reason first: it is the one that is told.
        self._interlocks: tuple[Interlock, ...] = (
            self._readings,
            self._presence,
            self._obedience,
            self._twin,
        )

    def wait(self, records: Sequence[Record]) -> Trip | None:
        """Before anything was commanded: links may come and go, readings must make sense."""
        return _first(lock.see(r) for r in records for lock in (self._readings, self._twin))

    def begin(self, now: int, boots: Mapping[str, str]) -> None:
        """From now on all count; `boots` are the devices' present starts by link."""
        self._presence.begin(now, boots)

    def commanded(self, now: int, number: int, pwm: tuple[int, ...]) -> None:
        """A command was sent: its number and its counts."""
        self._obedience.commanded(now, number, pwm)

    def check(self, records: Sequence[Record], now: int) -> Trip | None:
        """The reason to stop, or `None`.

        **Arguments:**

        - `records`: what came since the last call.
        - `now`: host time, ns.
        """
        seen = _first(lock.see(record) for record in records for lock in self._interlocks)
        return seen or _first(lock.check(now) for lock in self._interlocks)


def _first(trips: Iterable[Trip | None]) -> Trip | None:
    return next((trip for trip in trips if trip is not None), None)
