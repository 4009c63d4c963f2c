"""Pairs of a twin and its controller in a store of twins."""

import json
from datetime import UTC, datetime
from typing import Any, NamedTuple, final

from ..control import AbstractController, ControllerDesign, controller_file, controller_of_text
from ..errors import ControlError
from ..rig import Rig
from ..twin_store import TwinStore, TwinVersion
from ._loop_band import LoopBand
from ._retune import retune
from ._retuned import Retuned

# The beginning of the tags of a champion whose retuned controller was not accepted.
TAG = "retune"


@final
class Pair(NamedTuple):
    """The controller of a version of a store.

    - `controller`: the controller. `design`: for what it was designed; None if nothing says it.
    - `band`: the error of its loop that the trial predicted; None for a controller that was not
      tried.
    """

    controller: AbstractController
    design: ControllerDesign | None
    band: LoopBand | None


def pair_of(version: TwinVersion, rig: Rig) -> Pair | None:
    """Returns the controller of a version; None if it has none.

    **Raises:** `ControlError` if it is not one for the rig.
    """
    if version.controller_text is None:
        return None
    controller, design = controller_of_text(version.controller_text, version.address, rig)
    if (band := version.trial.get("band")) is None:
        return Pair(controller, design, None)
    try:
        return Pair(controller, design, LoopBand.of_dict(band))
    except (KeyError, TypeError, ValueError):
        raise ControlError(
            f"{version.address}: trial.band: expected rest, after_step and largest_step, got "
            f"{band!r}"
        ) from None


def retune_champion(
    store: TwinStore,
    controller: AbstractController | None = None,
    design: ControllerDesign | None = None,
    **options: Any,
) -> tuple[Retuned, TwinVersion | None]:
    """Retunes the controller of the champion of a store, and writes down what was decided.

    **Arguments:**

    - `store`: the store.
    - `controller`, `design`: those of a champion without a controller of its own.
    - `options`: further keywords of `retune`.

    **Returns:** what was decided, and the challenger; None if there is none.

    **Raises:** `ControlError` if nothing says which controller it is, or for what it was designed;
    the errors of `retune` and of the store.
    """
    champion = store.version("champion")
    fit = champion.fit()
    if (pair := pair_of(champion, fit.twin.rig)) is not None:
        controller, design = pair.controller, pair.design or design
    if controller is None:
        raise ControlError(
            f"{champion.address}: controller: expected a champion with a controller of its own, or "
            "the file of one, got none"
        )
    if design is None:
        raise ControlError(
            f"{champion.address}: design: expected references, duration and objective for which "
            "the controller is tuned, got none; docs/deploy.md has an example"
        )
    retuned = retune(
        fit,
        controller,
        design.references,
        duration=design.duration,
        objective=design.objective,
        **options,
    )
    return retuned, keep_retuned(store, champion, retuned, design)


def keep_retuned(
    store: TwinStore, champion: TwinVersion, retuned: Retuned, design: ControllerDesign
) -> TwinVersion | None:
    """Writes down what was decided: an accepted candidate becomes a version with the twin of the
    champion, its `challenger`; of any other the champion gets a tag that says why.

    **Arguments:**

    - `store`: the store. `champion`: the version whose twin the controller was tuned on.
    - `retuned`: what was decided. `design`: for what the controller is designed.

    **Returns:** the challenger; None if there is none.
    """
    if retuned.decision != "accepted" or retuned.candidate is None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        gains = json.dumps(retuned.to_dict()["parameters"])
        store.set_tag(
            champion.number,
            f"{TAG} {now}",
            f"{retuned.decision}: {retuned.reason}; from, to: {gains}",
        )
        return None
    fit = champion.fit()
    return store.add(
        fit,
        reason=retuned.reason,
        parent=champion.number,
        noise=champion.noise,
        aliases=["challenger"],
        controller=controller_file(retuned.candidate, fit.twin.rig, "retune", design),
        trial=retuned.to_dict(),
    )
