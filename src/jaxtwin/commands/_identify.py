"""`jaxtwin identify`: a rig file and a matched twin from recordings alone."""

from pathlib import Path
from typing import Annotated

import typer

from .._whole_file import write_whole_file
from ..errors import RigError
from ._options import JsonOption
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress


def identify(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Recordings of the same device.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The rig file, .toml.")],
    fit: Annotated[
        Path | None,
        typer.Option(
            "--fit", metavar="FILE", help="The matched twin, .toml, for the other commands."
        ),
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Use this channel, instead of all; may be repeated."),
    ] = None,
    ambient: Annotated[
        float | None, typer.Option(metavar="DEGC", help="The temperature of the room, if known.")
    ] = None,
    notes: Annotated[
        str | None, typer.Option(metavar="TEXT", help="A description for the rig file.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find the thermal network behind a log, without a rig file, and match it.

    Some hundred structures are compared; the summary says how well the chosen one predicts what it
    was not matched to, beside two simple models.
    """
    check_output(out, ".toml")
    check_output(fit, ".toml", option="--fit")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        from .. import identification  # which takes a second

        progress.step(f"identifying {', '.join(path.name for path in logs)}")
        identified = identification.identify(
            logs,
            channels=channel or None,
            ambient=ambient,
            notes=notes,
            on_progress=progress.update,
        )
        progress.step(f"writing {out}")
        write_whole_file(str(out), identified.rig.text.encode(), RigError)
        if fit is not None:
            identified.fit.save(fit)
    say(identified.summary(), json)
    say_written(out, fit, json_path=json)
    write_json(json, identified.to_dict())
