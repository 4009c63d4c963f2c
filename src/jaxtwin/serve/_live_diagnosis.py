"""A rig that has changed is diagnosed, and its champion refitted, from the last minutes of its
records."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

from ..io import Experiment
from ..live import Finding, Record, RigState
from ..monitoring import KINDS
from ..observers import ProcessNoise
from ..physics import Twin
from ._child_process import ChildProcess, Outcome
from ._recent_samples import RecentSamples

if TYPE_CHECKING:
    from ..twin_store import TwinStore


# The times after a finding at which is diagnosed, s of the rig: later, more is known.
DELAYS = (60.0, 300.0)

# The smallest number of samples of a diagnosis: an observer needs two minutes to find the rig.
MIN_SAMPLES = 180


@final
class LiveDiagnosis:
    """Says which fault explains what a monitor has found. It consumes the records of a source.

    **Arguments:**

    - `twin`: the twin.
    - `recent`: the last samples, which another consumer before this one keeps.
    - `show`: called, in the thread of the loop, with what a page shows of a diagnosis.
    - `noise`: the levels of the noise, as for `jaxtwin.diagnose`.
    """

    def __init__(
        self,
        twin: Twin,
        recent: RecentSamples,
        show: Callable[[dict[str, Any]], object],
        noise: ProcessNoise | None = None,
    ):
        self._twin, self._recent, self._show, self._noise = twin, recent, show, noise
        self._due: list[float] = []
        self._causes: list[dict[str, Any]] = []  # as they were shown last
        self._process = ChildProcess()
        self._is_outdated = False  # whether what runs diagnoses with a twin that is not in use

    def use(self, twin: Twin, noise: ProcessNoise | None) -> None:
        """Diagnoses with another twin from now on."""
        self._twin, self._noise = twin, noise
        self._due, self._causes = [], []
        self._is_outdated = self._process.is_running

    def on_finding(self, finding: Finding) -> None:
        """Plans diagnoses after an alarm of the monitor."""
        if finding.is_alarm and finding.kind in KINDS.values() and not self._due:
            self._due = [self._recent.now + delay for delay in DELAYS]
            self._show({"state": "awaited", "causes": self._causes})

    def on_record(self, record: Record, state: RigState) -> None:
        """Does nothing: the samples are kept elsewhere."""

    def on_time(self, state: RigState, now: int) -> None:
        """Begins a diagnosis that is due, and shows one that is ready."""
        outcome = self._process.take()
        if outcome is not None and not self._is_outdated:
            self._finish(outcome)
        self._is_outdated = self._is_outdated and outcome is None
        is_due = bool(self._due) and self._recent.now >= self._due[0]
        if is_due and not self._process.is_running:
            self._due = [time for time in self._due if time > self._recent.now]
            if len(self._recent) >= MIN_SAMPLES:
                self._show({"state": "running", "causes": self._causes})
                recorded = self._recent.recorded()
                self._process.begin(causes_of, self._twin, recorded, self._noise)
            elif not self._due:
                text = f"expected {MIN_SAMPLES} samples, got {len(self._recent)}"
                self._show({"state": "failed", "text": text, "causes": self._causes})

    def close(self) -> None:
        """Ends a diagnosis that runs."""
        self._process.close()

    def _finish(self, outcome: Outcome) -> None:
        if outcome.problem:
            self._show({"state": "failed", "text": outcome.problem, "causes": []})
            return
        for cause in outcome.value:
            if cause["until_s"] is not None:
                cause["until"] = self._recent.host_time(cause["until_s"])
            for explanation in cause["explanations"]:
                explanation["onset"] = self._recent.host_time(explanation["onset_s"])
        self._causes = outcome.value
        self._show({"state": "done", "causes": self._causes})


def causes_of(twin: Twin, recorded: Experiment, noise: ProcessNoise | None) -> list[dict[str, Any]]:
    """The causes of what changed, as `Diagnosis.to_dict` gives them.

    **Raises:** the errors of `jaxtwin.diagnose`.
    """
    from ..diagnosis import diagnose  # the process of the page needs none of it

    return diagnose(twin, recorded, None, noise).to_dict()["causes"]


# Refits the champion of a store to the last minutes of a rig, when a person asks for it.


@final
class LiveRefit:
    """Refits the champion, and lets the gate of `jaxtwin.refit` decide. It consumes the records of
    a source. A new champion is followed as soon as the store has it.

    **Arguments:**

    - `store`: the store.
    - `recent`: the last samples, which another consumer before this one keeps.
    - `say`: called, in the thread of the loop, with what was decided.
    """

    def __init__(self, store: "TwinStore", recent: RecentSamples, say: Callable[[str], object]):
        self._store, self._recent, self._say = store, recent, say
        self._process = ChildProcess()

    @property
    def is_running(self) -> bool:
        """Whether a refit goes on."""
        return self._process.is_running

    def begin(self, length: float) -> None:
        """Begins a refit to the last `length` seconds of the rig.

        **Raises:** `RecordingError` if there is no reading yet.
        """
        self._process.begin(refit_champion, self._store, self._recent.recorded(length))

    def on_record(self, record: Record, state: RigState) -> None:
        """Does nothing: the samples are kept elsewhere."""

    def on_time(self, state: RigState, now: int) -> None:
        """Says what was decided, once it was."""
        outcome = self._process.take()
        if outcome is not None:
            self._say(f"refit: {outcome.problem or outcome.value}")

    def close(self) -> None:
        """Ends a refit that goes on; nothing is written then."""
        self._process.close()


def refit_champion(store: "TwinStore", recorded: Experiment) -> str:
    """Refits the champion of a store to a recording, and writes the decision down.

    **Returns:** the decision and its reason.

    **Raises:** the errors of `jaxtwin.refit` and of the store.
    """
    from ..refitting import refit  # the process of the page needs none of it
    from ..refitting._refit import keep_refit

    champion = store.version("champion")
    result = refit(champion.fit(), recorded, noise=champion.noise)
    keep_refit(store, champion, recorded, result)
    return f"{result.decision}: {result.reason}"
