"""The champion of a store as the twin beside a rig, also after another one was promoted."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ..live import Draws, Finding
from ..monitoring import LiveMonitor, MonitorCalibration
from ..observers import ExtendedKalmanFilter, ProcessNoise, live_observer
from ..physics import Twin
from ._contents import look_ahead

if TYPE_CHECKING:
    from ..twin_store import TwinStore, TwinVersion


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


# The time between two looks at the store, s, which another process may change.
LOOK_SECONDS = 5.0


@final
class Champion:
    """Follows the champion of a store.

    **Arguments:**

    - `store`: the store, whose champion is a twin of the rig.
    - `made`: makes the twin beside the rig from a version.
    """

    def __init__(self, store: "TwinStore", made: "Callable[[TwinVersion], TwinBeside]"):
        self.store = store
        champion = store.version("champion")
        self.number = champion.number
        """The version that is followed."""
        self._made, self._version = made, champion
        self._looked = 0

    def next(
        self,
        now: int,
        *,
        is_driven: bool = False,
        accepts: "Callable[[TwinVersion], bool] | None" = None,
    ) -> TwinBeside | None:
        """Returns the twin of a new champion; None if there is no other. Of one that differs in its
        controller alone the number is followed, and the twin goes on.

        **Arguments:**

        - `now`: host time, ns.
        - `is_driven`: whether the rig is driven now. A twin whose observer has other states, which
          compiles for seconds, then waits.
        - `accepts`: whether a version can be followed now; others wait. None: all can.

        **Raises:** `StoreError` if the store cannot be read, and the errors of making the twin.
        """
        if now - self._looked < LOOK_SECONDS * 1e9:
            return None
        self._looked = now
        if self.store.aliases.get("champion", self.number) == self.number:
            return None
        version = self.store.version("champion")
        before = self._version
        if is_driven and _uncertain(version) != _uncertain(before):
            return None
        if accepts is not None and not accepts(version):
            return None
        twins = [(each.fit_text, each.noise_text) for each in (before, version)]
        is_same = twins[0] == twins[1] and version.controller_text != before.controller_text
        beside = None if is_same else self._made(version)
        self.number, self._version = version.number, version
        return beside

    def look_at_once(self) -> None:
        """Makes `next` look at the store, whenever it looked last."""
        self._looked = 0

    def content(self) -> dict[str, Any]:
        """The versions of the store, the newest first, for a page."""
        return {
            "store": self.store.path.name,
            "followed": self.number,
            "versions": [
                {
                    "number": version.number,
                    "made": version.made,
                    "parent": version.parent,
                    "reason": version.reason,
                    "aliases": list(version.aliases),
                }
                for version in reversed(self.store.versions[-20:])
            ],
        }


def _uncertain(version: "TwinVersion") -> tuple[str, ...]:
    """The names of the slowly drifting parameters in the noise of its observer."""
    noise = version.noise
    return () if noise is None else noise.names
