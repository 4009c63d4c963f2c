"""Interlock: an alarm of whoever else watches the rig, such as a monitor."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, final

from ..protocol._records import Record
from ..protocol._rig_state import RigState
from ._interlock import AbstractInterlock, Finding


@final
class AlarmInterlock(AbstractInterlock):
    """Trips on the first alarm that it is told of. It belongs to the rigs whose file says
    `limits.stop_on_alarm`.

    ```python
    interlock = AlarmInterlock()
    monitor = LiveMonitor(live_observer(twin), interlock.ring)
    guard = Guard([*interlocks_of(twin), interlock])
    operate(connection, guard, duty, consumers=[monitor])
    ```
    """

    def __init__(self) -> None:
        self._alarm: Finding | None = None

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"stop_on_alarm": True}

    def ring(self, finding: Finding) -> None:
        """Takes a finding; a notice is no alarm."""
        if self._alarm is None and finding.is_alarm:
            detail = f"alarm, {finding.kind}: {finding.detail}"
            self._alarm = replace(finding, kind="alarm", detail=detail)

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        return self._alarm

    def on_time(self, state: RigState, now: int) -> Finding | None:
        return self._alarm
