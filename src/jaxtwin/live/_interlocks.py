"""Interlocks: each checks the records of a rig and decides when the cells must be switched off.

They have no side effects: they compute a trip from records, commands and the time. `Guard` combines
them, and checks every run that commands a rig.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, final, runtime_checkable

from ..physics import Twin
from ._obedience import Obedience
from ._operating_limits import OperatingLimits
from ._plausibility import Plausibility, check_ambient
from ._presence import Presence
from ._records import Record
from ._trip import Trip
from ._twin_watch import TwinWatch


@runtime_checkable
class Interlock(Protocol):
    """Checks for one kind of danger."""

    def see(self, record: Record) -> Trip | None:
        """Checks a record of the rig. Returns the reason to stop, if there is any."""
        ...

    def check(self, now: int) -> Trip | None:
        """Checks for missing records at host time `now`, ns. Returns the reason to stop, if any."""
        ...


@final
class Guard:
    """All interlocks of a rig.

    **Arguments:**

    - `twin`: the twin of the rig, whose file must state `limits.temperature`.
    - `owner`: the name under which the rig is commanded (`Bench.owner`).
    - `silence`: the longest time without a controller sample, or without valid temperatures, s.
    - `ambient`: the ambient temperature of a rig that does not measure it, degC; None: unknown.

    **Raises:** `JaxtwinError` if the rig file states no limit, or for an ambient temperature that
    no room has.
    """

    def __init__(
        self,
        twin: Twin,
        owner: str,
        *,
        silence: float | int = 3.0,
        ambient: float | int | None = None,
    ):
        self.limits = OperatingLimits.of(twin)
        given = check_ambient(ambient, self.limits)
        rig = twin.rig
        channels = tuple(channel.name for channel in rig.channels)
        cells = tuple(cell.name for cell in rig.cells)
        self._presence = Presence(float(silence))
        self._obedience = Obedience(owner, cells, self.limits.command_delay)
        self._readings = Plausibility(channels, self.limits, rig.driver)
        self._twin = TwinWatch(twin, self.limits, given)
        # The plainest reason first, because only the first is reported.
        self._interlocks: tuple[Interlock, ...] = (
            self._readings,
            self._presence,
            self._obedience,
            self._twin,
        )

    def wait(self, records: Sequence[Record]) -> Trip | None:
        """Checks before the first command: links may be lost, readings must be plausible."""
        return _first(lock.see(r) for r in records for lock in (self._readings, self._twin))

    def ready(self) -> Trip | None:
        """Checks at the first command, after samples and readings, that the room is known."""
        return self._twin.strange_room()

    def begin(self, now: int, boots: Mapping[str, str]) -> None:
        """Begins to check all interlocks; `boots` are the present starts of the devices by link."""
        self._presence.begin(now, boots)

    def commanded(self, now: int, number: int, pwm: tuple[int, ...]) -> None:
        """Registers that a command was sent, with its number and its counts."""
        self._obedience.commanded(now, number, pwm)

    def check(self, records: Sequence[Record], now: int) -> Trip | None:
        """Returns the reason to stop, or `None`.

        **Arguments:**

        - `records`: those since the last call.
        - `now`: host time, ns.
        """
        trip = _first(lock.see(record) for record in records for lock in self._interlocks)
        return trip or _first(lock.check(now) for lock in self._interlocks)


def _first(trips: Iterable[Trip | None]) -> Trip | None:
    return next((trip for trip in trips if trip is not None), None)
