"""`jaxtwin retune`: the controller of a store's champion, tuned again and tried on the twin."""

from pathlib import Path
from typing import Annotated

import typer

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
            help="The present controller with its design, .toml, of a champion without one.",
        ),
    ] = None,
    draws: Annotated[
        int, typer.Option(min=1, help="Draws of the twin with which it is tried.")
    ] = 100,
    json: JsonOption = None,
) -> None:
    """Tune a controller on the champion of a store, for what its file says that it was designed
    for, and try it there beside the present controller: in other rooms, with a lost sensor, twice
    the delay, faults.

    What passes is added as challenger, with its table of scenarios: 'jaxtwin twins promote' makes
    it the champion. The exit code is 3 if the candidate was rejected.
    """
    from ..control import read_controller, read_design
    from ..retuning import retune_champion

    check_json(json)
    twins = open_store(store)
    with show_progress() as progress:
        progress.step("tuning and trying")
        present = design = None
        if controller is not None:
            rig = twins.version("champion").fit().twin.rig
            present, design = read_controller(controller, rig), read_design(controller, rig)
        retuned, challenger = retune_champion(twins, present, design, draws=draws)
    say(retuned.summary(), json)
    number = None if challenger is None else challenger.number
    if number is not None:
        say(f"version {number} waits as challenger", json)
    write_json(json, {"challenger": number, **retuned.to_dict()})
    if retuned.decision == "rejected":
        raise typer.Exit(REJECTED)
