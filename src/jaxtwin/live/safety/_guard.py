"""The guard of a rig: its interlocks, all of which are asked about every record."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, final

from ...errors import JaxtwinError
from ...io import Experiment
from ...physics import Twin
from ..protocol._records import Record
from ..protocol._rig_state import RigState
from ._hidden_heat import HottestPart
from ._interlock import AbstractInterlock, Finding
from ._obedience import Obedience
from ._off_watch import OffWatch
from ._operating_limits import OperatingLimits
from ._plausibility import Plausibility, check_ambient
from ._presence import Presence
from ._twin_ensemble import Draws
from ._twin_watch import TwinWatch


def interlocks_of(
    twin: Twin,
    *,
    silence: float | int = 3.0,
    ambient: float | int | None = None,
    limits: OperatingLimits | None = None,
    draws: Draws | None = None,
) -> tuple[AbstractInterlock, ...]:
    """The interlocks that guard every rig, the plainest reason first, because only the first is
    reported.

    **Arguments:**

    - `twin`: the twin of the rig, whose file must state `limits.temperature`.
    - `silence`: the longest time without a controller sample, or without valid temperatures, s.
    - `ambient`: the ambient temperature of a rig that does not measure it, degC; None: unknown.
    - `limits`: the limits of the rig; None: those of its file (`OperatingLimits.of`).
    - `draws`: values of the twin's parameters that its match does not exclude, as
      `jaxtwin.matching.posterior_draws(fit, 32)` gives them. With them the interlocks know how well
      the twin is known; None: they take it for exact (`HiddenHeat`).

    **Raises:** `JaxtwinError` if the rig file states no limit, or for a silence or an ambient
    temperature that cannot be.
    """
    limits = OperatingLimits.of(twin) if limits is None else limits
    given = check_ambient(ambient, limits)
    rig = twin.rig
    return (
        Plausibility(twin.channels, limits, rig.driver),
        Presence(float(silence)),
        Obedience(rig.driven, limits.command_delay),
        TwinWatch(twin, limits, given, draws),
    )


@final
class Guard:
    """Watches a driven rig by its interlocks. It consumes the records of a source, and keeps the
    first finding.

    **Arguments:**

    - `interlocks`: those of the rig (`interlocks_of`), and a user's own. They belong to this guard,
      and a guard to one run. A plan is judged by the `TwinWatch` among them alone (`check_plan`).
    """

    def __init__(self, interlocks: Sequence[AbstractInterlock]):
        self.finding: Finding | None = None
        """The first reason to stop; None if there is none."""
        self._interlocks = tuple(interlocks)
        self._twin_watches = [lock for lock in self._interlocks if isinstance(lock, TwinWatch)]
        self._used = False

    @classmethod
    def of(
        cls,
        twin: Twin,
        *,
        silence: float | int = 3.0,
        ambient: float | int | None = None,
        draws: Draws | None = None,
    ) -> "Guard":
        """A guard with the interlocks of every rig, `interlocks_of`."""
        return cls(interlocks_of(twin, silence=silence, ambient=ambient, draws=draws))

    @property
    def settings(self) -> dict[str, Any]:
        """What the interlocks are set to."""
        return {name: v for lock in self._interlocks for name, v in lock.settings.items()}

    def begin(self) -> None:
        """Begins a run.

        **Raises:** `JaxtwinError` if the guard has guarded another run: its interlocks know it.
        """
        if self._used:
            raise JaxtwinError("guard: expected a new one for each run, got one that has been used")
        self._used = True

    def on_record(self, record: Record, state: RigState) -> None:
        """Asks all interlocks about a record."""
        self._keep((lock.on_record(record, state) for lock in self._interlocks), record.arrival)

    def on_time(self, state: RigState, now: int) -> None:
        """Asks all interlocks at host time `now`, ns."""
        self._keep((lock.on_time(state, now) for lock in self._interlocks), now)

    def before_start(self, state: RigState, now: int) -> None:
        """Asks all interlocks before the first command."""
        self._keep((lock.before_start(state) for lock in self._interlocks), now)

    def check_plan(self, plan: Experiment) -> HottestPart | None:
        """Refuses a plan with which the interlocks would stop the rig, as its twin says; nothing is
        refused if no twin is among the interlocks.

        **Returns:** the part of the rig that comes nearest to its limit; None without a twin.

        **Raises:** `JaxtwinError` that names the part, the temperature and the time.
        """
        return next((watch.check_plan(plan) for watch in self._twin_watches), None)

    def follow(self, record: Record, state: RigState) -> None:
        """Lets the twins beside the rig follow it after the end of the run."""
        for watch in self._twin_watches:
            watch.follow(record, state)

    def off_watch(self, now: int) -> OffWatch | None:
        """What tells after the end of the run by the readings whether the rig is off; None if it
        was not heated, or no twin is among the interlocks."""
        return next((watch.off_watch(now) for watch in self._twin_watches), None)

    def _keep(self, findings: Iterable[Finding | None], since: int) -> None:
        result = next((finding for finding in findings if finding is not None), None)
        if self.finding is None and result is not None:
            self.finding = result if result.since is not None else replace(result, since=since)
