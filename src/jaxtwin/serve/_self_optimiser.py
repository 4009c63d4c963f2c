"""The controller of a store's champion: tuned again after a refit, and watched after a change."""

import contextlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Literal, final

from ..control import AbstractController, ControllerDesign, Decision, is_same_kind
from ..errors import StoreError
from ..retuning import LoopBand, LoopWatch, pair_of, retune_champion
from ..retuning._loop_band import MIN_REST
from ..rig import Rig
from ._champion import LOOK_SECONDS
from ._child_process import ChildProcess

if TYPE_CHECKING:
    from ..twin_store import TwinStore, TwinVersion

Policy = Literal["propose", "apply"]

# The time for which a new controller has commanded the rig before it is trusted, s of the rig.
PROBATION_SECONDS = 1800.0

# The time between two promotions without a person, s.
PAUSE_SECONDS = 1800.0

# The number of promotions without a person in a day.
MAX_A_DAY = 3

# The tag of a version whose probation is over.
PROBATION_TAG = "probation"


@final
class SelfOptimiser:
    """Has the controller of a champion tuned again when its twin was refitted, and watches a new
    controller on the rig.

    **Arguments:**

    - `store`: the store of twins and controllers.
    - `rig`: the rig.
    - `controller`, `design`: the controller of versions without one of their own, and for what it
      was designed.
    - `policy`: whether an accepted candidate waits for a person, or is promoted at rest.
    - `say`: called, in the thread of the loop, with a level and what was decided.
    - `now`: the time, UTC.
    """

    def __init__(
        self,
        store: "TwinStore",
        rig: Rig,
        controller: AbstractController,
        design: ControllerDesign,
        policy: Policy,
        say: Callable[[str, str], object],
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ):
        self._store, self._rig, self._policy, self._say, self._now = store, rig, policy, say, now
        self._usual, self._design = controller.for_rig(rig), design
        self._process = ChildProcess()
        self._proposed: int | None = None
        self._looked = datetime.fromtimestamp(0, UTC)
        self.number = 0
        """The version whose controller is in use."""
        self.controller = self.previous = self._usual
        """The controller in use, and that of the version from which it was made."""
        self.worse = ""
        """Why the loop is worse than its trial; `""` if it is not."""
        self.is_on_probation = False
        """Whether the controller in use goes back at the first reason."""
        self.use(store.version("champion"))

    @property
    def is_at_rest(self) -> bool:
        """Whether the loop has been at rest for a minute."""
        return self._watch.is_at_rest

    def controller_of(self, version: "TwinVersion") -> AbstractController:
        """The controller of a version.

        **Raises:** `ControlError` if it is none for the rig.
        """
        pair = pair_of(version, self._rig)
        return self._usual if pair is None else pair.controller

    def fits(self, version: "TwinVersion") -> bool:
        """Whether a loop that runs can go on with the controller of a version: one of the same
        kind, limits and sample time, which needs no compilation."""
        return is_same_kind(self.controller_of(version), self.controller)

    def use(self, version: "TwinVersion") -> None:
        """Goes on with a version; a new controller is on probation from now on."""
        is_refitted = bool(self.number) and version.parent == self.number and not version.trial
        pair = pair_of(version, self._rig)
        self.number, self.worse = version.number, ""
        self.controller = self._usual if pair is None else pair.controller
        band = None if pair is None else pair.band
        self._is_judged = band is not None
        self._watch = LoopWatch(LoopBand(MIN_REST, (0.0,), 0.0) if band is None else band)
        if version.parent is not None:
            self.previous = self.controller_of(self._store.version(version.parent))
        has_before = version.parent is not None and PROBATION_TAG not in version.tags
        self.is_on_probation = self._is_judged and has_before
        if is_refitted:
            self.begin()

    def begin(self) -> None:
        """Begins to tune the controller on the champion, unless that goes on already."""
        if not self._process.is_running:
            self._say("notice", "the controller is tuned on the new twin")
            self._process.begin(retuned_champion, self._store, self._usual, self._design)

    def update(self, decision: Decision) -> None:
        """Takes a sample of the loop."""
        text = self._watch.update(decision)
        if text and self._is_judged:
            self.worse = text
        elif self.is_on_probation and self._watch.time >= PROBATION_SECONDS:
            self.is_on_probation = False
            self._say("notice", f"the controller of version {self.number} has kept to its trial")
            text = f"passed, {self._watch.time:.0f} s as predicted"
            with contextlib.suppress(StoreError):  # which ends no run; a restart begins anew
                self._store.set_tag(self.number, PROBATION_TAG, text)

    def turn(self, *, is_at_rest: bool) -> bool:
        """Says what was decided, once it was, and promotes a candidate if the policy says so, the
        loop is at rest, and it is time.

        **Returns:** whether the champion was moved.
        """
        outcome = self._process.take()
        if outcome is not None:
            text, self._proposed = outcome.value or (outcome.problem, None)
            self._say("notice", f"retune: {text}")
            if self._proposed is not None and self._policy == "propose":
                self._say("notice", f"version {self._proposed} waits for somebody to promote it")
        waits = self._now() - self._looked < timedelta(seconds=LOOK_SECONDS)
        if self._policy != "apply" or self._proposed is None or not is_at_rest or waits:
            return False
        self._looked = self._now()
        version = self._store.version(self._proposed)
        if version.parent != self.number or "challenger" not in version.aliases:
            self._proposed = None  # the twin has changed meanwhile, or a person has decided
            return False
        if self.is_on_probation or not self._is_time():
            return False
        self._store.promote(version.number, reason=version.reason)
        self._proposed = None
        return True

    def close(self) -> None:
        """Ends work that goes on; nothing is written then."""
        self._process.close()

    def _is_time(self) -> bool:
        """Whether a promotion without a person would be neither too early nor one too many. What a
        store remembers counts, so that a restart changes nothing."""
        tried = {version.number for version in self._store.versions if version.trial}
        promotions = [
            datetime.fromisoformat(move.made)
            for move in self._store.history("champion")
            if move.after in tried or move.before in tried
        ]
        recent = [moved for moved in promotions if self._now() - moved < timedelta(days=1)]
        paused = not promotions or self._now() - promotions[-1] >= timedelta(seconds=PAUSE_SECONDS)
        return paused and len(recent) < MAX_A_DAY


def retuned_champion(
    store: "TwinStore", controller: AbstractController, design: ControllerDesign
) -> tuple[str, int | None]:
    """As `retune_champion`, for another process.

    **Returns:** the decision and its reason, and the version of an accepted candidate.
    """
    retuned, challenger = retune_champion(store, controller, design)
    number = None if challenger is None else challenger.number
    return f"{retuned.decision}: {retuned.reason}", number
