"""The monitor beside a rig."""

from collections.abc import Callable
from typing import final

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from .._compilation import persistent_jit, persistent_jit_unoptimised
from ..live import Follower, Reading, Record, RigState
from ..live.protocol._clock import seconds
from ..live.safety._interlock import Finding
from ..observers import ExtendedKalmanFilter, KalmanState
from ._evidence import Evidence, joined, seen
from ._live_findings import LiveFindings
from ._monitor import Monitor, MonitorState, channels_of
from ._response import response_of
from ._thresholds import DAY, MonitorCalibration, nominal_calibration


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
    after, evidences = monitor.step(state, seen(observed, expected, readings, ambient, dt))
    return after, joined(evidences)
