"""The findings of a monitor beside a rig, each told once."""

from collections.abc import Callable
from typing import Any, final

from ..live.safety._interlock import Finding
from ._evidence import Evidence
from ._finding_log import MIN_CHANNELS, FindingLog, begin_together, together
from ._monitor import Monitor, channels_of
from ._thresholds import MonitorCalibration

# Host times are in ns.
TICKS = 10**9

# The number of findings that are kept after they are over: a rig may be watched for months.
MAX_ENDED_FINDINGS = 1000


@final
class LiveFindings:
    """Turns what a monitor says of each reading of a rig into findings.

    **Arguments:**

    - `monitor`: the monitor. `calibration`, `false_alarm_time`: what it was made with.
    - `on_finding`: called with each new finding. Where findings of one kind begin in several
      channels together, it is called for the first two: the others have the same cause.
    - `kept`: how many findings that are over are kept.
    """

    def __init__(
        self,
        monitor: Monitor,
        calibration: MonitorCalibration,
        false_alarm_time: float | int,
        on_finding: Callable[[Finding], None],
        kept: int = MAX_ENDED_FINDINGS,
    ):
        self._channels = channels_of(monitor.model)
        self._log = FindingLog(monitor, calibration, false_alarm_time, TICKS, kept)
        self._on_finding = on_finding
        # A second of the rig in the unit of the times of findings.
        self._second = float(TICKS)

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings that are there now; those that began in most channels together are one."""
        return tuple(together(self._log.present, self._channels, self._second))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings that are kept; those that are over have an `until`."""
        return tuple(together(self._log.findings, self._channels, self._second))

    @property
    def is_any_present(self) -> bool:
        """Whether there are findings now, which `take` may end although nothing is said."""
        return self._log.is_any_present

    def take(self, now: int, evidence: Evidence, rate: float = 1.0) -> None:
        """Takes what the tests say of a reading at host time `now`, ns, and tells what is new;
        `rate` is the seconds of the rig in one of the host."""
        self._second = TICKS / rate
        for finding in self._log.take(now, evidence, rate):
            if not self._is_told(finding):
                self._on_finding(finding)

    def to_dict(self) -> dict[str, Any]:
        """The findings as a dictionary that JSON can hold, from which `resume` goes on."""
        return self._log.to_dict()

    def resume(self, content: dict[str, Any]) -> None:
        """Goes on from what `to_dict` gave."""
        self._log.resume(content)

    def _is_told(self, finding: Finding) -> bool:
        """Whether a finding of a channel belongs to those of other channels that were told."""
        if finding.channel not in self._channels:
            return False
        others = {
            other.channel
            for other in self._log.present
            if other.channel != finding.channel
            and other.channel in self._channels
            and self._order(other) < self._order(finding)
            and begin_together(other, finding, self._second)
        }
        return len(others) >= MIN_CHANNELS - 1

    def _order(self, finding: Finding) -> tuple[int | float, int]:
        """When a finding was found, and the place of its channel."""
        return finding.found or 0, self._channels.index(finding.channel)
