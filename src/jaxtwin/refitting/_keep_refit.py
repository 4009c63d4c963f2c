"""Writes down in a store of twins what a refit has decided."""

from ..io import Experiment
from ..twin_store import TwinStore, TwinVersion
from ._refit import Refit

# Tags of the version that judged a recording: `refit` and the beginning of its fingerprint.
TAG = "refit"


def keep_refit(
    store: TwinStore, champion: TwinVersion, recording: Experiment, result: Refit
) -> TwinVersion:
    """Writes down what was decided: a promoted twin becomes the champion, and one of which a person
    is asked the challenger. The champion so far gets a tag that says what was decided.

    **Arguments:**

    - `store`: the store. `champion`: the version that was refitted.
    - `recording`: the recording to which it was refitted.
    - `result`: the refit.

    **Returns:** the champion from now on.
    """
    store.set_tag(
        champion.number,
        f"{TAG} {recording.fingerprint[:12]}",
        f"{result.decision}: {result.reason}",
    )
    if result.fit is None or result.decision not in ("promoted", "ask"):
        return champion
    added = store.add(
        result.fit,
        reason=result.reason,
        parent=champion.number,
        noise=champion.noise,
        aliases=["challenger"],
        controller=champion.controller_text,  # which goes on until it is tuned again
    )
    if result.decision == "ask":
        return champion
    return store.promote(added.number, reason=result.reason)
