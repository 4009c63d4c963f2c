"""The twin that follows a rig: one for each rig, not for each client."""

from typing import final

import numpy as np

from ..live import Finding
from ..live.safety._twin_ensemble import Draws
from ..monitoring import LiveMonitor, MonitorCalibration
from ..observers import ExtendedKalmanFilter, ProcessNoise, live_observer
from ..physics import Twin
from ._outlook import look_ahead

# The usual time between two readings for which an observer is made, s.
SAMPLE_TIME = 1.0


@final
class TwinBeside:
    """A twin with the observer and the monitor that run beside a rig.

    **Arguments:**

    - `twin`: the twin.
    - `label`: what it is, for people, such as `version 3 of twins.db`.
    - `noise`: the levels of the noise of the observer; None: usual ones.
    - `calibration`: what is healthy; None: usual thresholds.
    - `sample_time`: the time between two readings, s.
    - `draws`: of what is not known of its values, for the interlocks of a run; None: it is taken
      for exact.
    """

    def __init__(
        self,
        twin: Twin,
        label: str,
        *,
        noise: ProcessNoise | None = None,
        calibration: MonitorCalibration | None = None,
        sample_time: float | int = SAMPLE_TIME,
        draws: Draws | None = None,
    ):
        self.twin = twin
        self.label = label
        self.noise = noise
        self.draws = draws
        self._news: list[Finding] = []
        self.observer: ExtendedKalmanFilter = live_observer(twin, noise, sample_time)
        self.monitor = LiveMonitor(
            self.observer, self._news.append, calibration=calibration, sample_time=sample_time
        )
        follower = self.monitor.follower
        # This compiles before the first data arrive.
        look_ahead(self.observer, follower.state, np.zeros(len(twin.rig.driven)))

    def take_news(self) -> list[Finding]:
        """Returns the findings of the monitor that are new since the last call."""
        news = self._news.copy()
        self._news.clear()
        return news
