"""What an interlock is: a check of a driven rig, without side effects. The simplest passes an alarm
on."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, final

from ..protocol._records import Record
from ..protocol._rig_state import RigState

Severity = Literal["notice", "warning", "critical"]


@final
@dataclass(frozen=True)
class Finding:
    """What a check has found on a rig.

    **Arguments:**

    - `kind`: the reason in a single word, for programs.
    - `detail`: the reason as a sentence, for people.
    - `channel`: the channel, the cell or the link that it concerns; `""` for the rig as a whole.
    - `since`: from when on it is there, None if nobody says: on a live rig host time, ns since
      1970; in a recording its time, s.
    - `severity`: `critical` if the rig is too hot, or if nobody can know; somebody must come then.
      A `notice` is no alarm.
    - `size`, `unit`: how large it is, and in which unit; None if it has no size. `""`: a factor or
      a relative change.
    - `probability`: the probability that it is there, 0 to 1; None if nobody says.
    - `found`, `until`: when it was found, and when it was there last, as `since`; `until` is None
      while it is there.
    """

    kind: str
    detail: str
    channel: str = ""
    since: int | float | None = None
    severity: Severity = "warning"
    size: float | None = None
    unit: str = ""
    probability: float | None = None
    found: int | float | None = None
    until: int | float | None = None

    @property
    def is_alarm(self) -> bool:
        """Whether somebody should look, other than at a notice."""
        return self.severity != "notice"

    def __str__(self) -> str:
        return self.detail


class AbstractInterlock(ABC):
    """A check for one kind of danger. What it finds, of any severity, switches the cells off.

    A `Guard` asks all its interlocks about every record of the rig. The records contain the host's
    own commands (`Command`), and the documents at the start and the end of a run (`Document`).
    """

    @property
    def settings(self) -> Mapping[str, Any]:
        """What it is set to, for the recording of a run: name with its unit -> number."""
        return {}

    @abstractmethod
    def on_record(self, record: Record, state: RigState) -> Finding | None:
        """Checks a record. Returns the reason to stop, if there is one.

        **Arguments:**

        - `record`: the next record, from before the first command on.
        - `state`: what is known of the rig after it.
        """

    def on_time(self, state: RigState, now: int) -> Finding | None:
        """Checks at host time `now`, ns, what no record shows, such as silence, from the first
        command on. Returns the reason to stop, if there is one."""
        return None

    def before_start(self, state: RigState) -> Finding | None:
        """Checks before the first command. Returns the reason not to start, if there is one."""
        return None


# Interlock: an alarm of whoever else watches the rig, such as a monitor.


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
