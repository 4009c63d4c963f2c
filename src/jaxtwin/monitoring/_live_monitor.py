"""The monitor beside a rig, and its findings, each told once."""

from collections.abc import Callable
from typing import Any, final

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from .._compilation import persistent_jit, persistent_jit_unoptimised
from ..live import Follower, Reading, Record, RigState
from ..live.protocol._clock import seconds
from ..live.safety._interlock import Finding
from ..observers import ExtendedKalmanFilter, KalmanState
from ._evidence import Evidence, joined, observed_sample
from ._finding_log import MIN_CHANNELS, FindingLog, begin_together, together
from ._monitor import Monitor, MonitorState, channels_of
from ._response import response_of
from ._thresholds import DAY, MonitorCalibration, nominal_calibration

# Host times are in ns.
NS_PER_SECOND = 10**9

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
        self._log = FindingLog(monitor, calibration, false_alarm_time, NS_PER_SECOND, kept)
        self._on_finding = on_finding
        # A second of the rig in the unit of the times of findings.
        self._second = float(NS_PER_SECOND)

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
        self._second = NS_PER_SECOND / rate
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


@final
class LiveMonitor:
    """Observes and monitors a rig. It consumes the records of a source, such as `Replay` or
    `RigConnection`, and raises findings as `Alarms` does.

    **Arguments:**

    - `observer`: the filter, as `jaxtwin.observers.live_observer` makes it.
    - `on_finding`: called with each new finding; notices among them are no alarms. Where findings
      of one kind begin in several channels together, it is called for the first two: the others
      have the same cause.
    - `calibration`: what is healthy; None: usual thresholds.
    - `false_alarm_time`: the mean time between two false alarms, s.
    - `sample_time`: the time between two readings, s, for usual thresholds.
    """

    def __init__(
        self,
        observer: ExtendedKalmanFilter,
        on_finding: Callable[[Finding], None],
        *,
        calibration: MonitorCalibration | None = None,
        false_alarm_time: float | int = 30 * DAY,
        sample_time: float | int = 1.0,
    ):
        if calibration is None:
            calibration = nominal_calibration(channels_of(observer.model), sample_time)
        self.observer = observer
        """The filter."""
        monitor = Monitor(observer, calibration, response_of(observer), false_alarm_time)
        self._take = _stepped.bind(monitor)
        self._findings = LiveFindings(monitor, calibration, false_alarm_time, on_finding)
        with jax.enable_x64(True):
            start = jax.tree.map(np.asarray, _begun(monitor))
        self._state = start
        self.follower = Follower(observer.model.twin, observer)
        """What follows the rig: its estimates are those of the monitor."""
        self._time: int | None = None
        nothing = np.full(len(channels_of(observer.model)), np.nan)
        self._step(nothing, nothing, 0.0)  # compiles before the first data arrive
        self._state = start

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings that are there now; those that began in most channels together are one."""
        return self._findings.present

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings since the start, of those that are over the last thousand; they have an
        `until`."""
        return self._findings.findings

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known of the rig after it."""
        self.follower.on_record(record, state)
        if not isinstance(record, Reading) or record.recalibrating:
            return
        expected = self.follower.predicted
        assert expected is not None
        now = state.time_of(record)
        dt = 0.0 if self._time is None else max(seconds(now - self._time) * state.rate, 0.0)
        self._time = now if self._time is None else max(now, self._time)
        evidence = self._step(record.temperatures, expected, dt)
        self._findings.take(self._time, evidence, state.rate)

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: findings come with readings. Silence is an alarm of `Alarms`."""

    def _step(self, readings: np.ndarray, expected: np.ndarray, dt: float) -> Evidence:
        ambient, dt = np.float64(self.follower.ambient), np.float64(dt)
        with jax.enable_x64(True):
            self._state, evidence = self._take(
                self._state, self.follower.device_state, expected, readings, ambient, dt
            )
        return evidence


@persistent_jit_unoptimised
def _begun(monitor: Monitor) -> MonitorState:
    return monitor.init()


@persistent_jit
def _stepped(
    monitor: Monitor,
    state: MonitorState,
    observed: KalmanState,
    expected: Float[ArrayLike, " channels"],
    readings: Float[ArrayLike, " channels"],
    ambient: Float[ArrayLike, ""],
    dt: Float[ArrayLike, ""],
) -> tuple[MonitorState, Evidence]:
    after, evidences = monitor.step(
        state, observed_sample(observed, expected, readings, ambient, dt)
    )
    return after, joined(evidences)
