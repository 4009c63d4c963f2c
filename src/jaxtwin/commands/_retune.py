"""`jaxtwin retune`: the controller of a store's champion, tuned again and tried on the twin."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import JaxtwinError
from ._exit_codes import REJECTED
from ._options import JsonOption
from ._output import check_json, say, write_json
from ._show_progress import show_progress
from ._sources import open_store


def retune(
    store: Annotated[
        Path, typer.Argument(metavar="STORE", help="A store of twins with a champion, .db.")
    ],
    controller: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The present controller with its design, .toml; default: that of the champion.",
        ),
    ] = None,
    draws: Annotated[
        int, typer.Option(min=1, help="Draws of the twin with which it is tried.")
    ] = 100,
    allowance: Annotated[
        float,
        typer.Option(min=0, help="The part by which it may be worse in a scenario."),
    ] = 0.1,
    seed: Annotated[int, typer.Option(min=0, help="Of draws, starts and noise.")] = 0,
    json: JsonOption = None,
) -> None:
    """Tune a controller on the champion of a store, for what its file says that it was designed
    for, and try it there beside the present controller: in other rooms, with a lost sensor, twice
    the delay, faults.

    What passes is added as challenger, with its table of scenarios: 'jaxtwin twins promote' makes
    it the champion. The exit code is 3 if the candidate was rejected.
    """
    from ..control import read_controller, read_design
    from ..retuning import keep_retuned, pair_of
    from ..retuning import retune as retuned

    check_json(json)
    twins = open_store(store)
    with show_progress() as progress:
        progress.step("reading")
        champion = twins.version("champion")
        fit = champion.fit()
        rig = fit.twin.rig
        if controller is not None:
            present, design = read_controller(controller, rig), read_design(controller, rig)
        else:
            pair = pair_of(champion, rig)
            if pair is None:
                raise JaxtwinError(
                    f"{champion.address}: controller: expected a champion with a controller of its "
                    "own, got none; give --controller"
                )
            present, design = pair.controller, pair.design
        if design is None:
            raise JaxtwinError(
                f"{controller or champion.address}: design: expected references, duration and "
                "objective for which the controller is tuned, got none; docs/deploy.md has an "
                "example"
            )
        progress.step("tuning and trying")
        found = retuned(
            fit,
            present,
            design.references,
            duration=design.duration,
            objective=design.objective,
            draws=draws,
            allowance=allowance,
            seed=seed,
        )
        kept = keep_retuned(twins, champion, found, design)
    say(found.summary(), json)
    if kept is not None:
        say(f"version {kept.number} waits as challenger", json)
    number = None if kept is None else kept.number
    write_json(json, {"champion": champion.number, "challenger": number, **found.to_dict()})
    if found.decision == "rejected":
        raise typer.Exit(REJECTED)
