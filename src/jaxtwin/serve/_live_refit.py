"""Refits the champion of a store to the last minutes of a rig, when a person asks for it."""

from collections.abc import Callable
from typing import TYPE_CHECKING, final

from ..io import Experiment
from ..live import Record, RigState
from ._child_process import ChildProcess
from ._recent_samples import RecentSamples

if TYPE_CHECKING:  # a page without a store does not import it
    from ..twin_store import TwinStore


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
    from ..refitting._keep_refit import keep_refit

    champion = store.version("champion")
    result = refit(champion.fit(), recorded, noise=champion.noise)
    keep_refit(store, champion, recorded, result)
    return f"{result.decision}: {result.reason}"
