"""`jaxtwin diagnose`: which fault explains what changes in recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._exit_codes import ALARMED
from ._options import JsonOption, NoiseOption, RecordingsArgument
from ._output import check_folder, check_json, say, say_written, write_json, write_pictures
from ._show_progress import show_progress
from ._sources import open_continuous

if TYPE_CHECKING:
    from ..diagnosis import Diagnosis


def diagnose(
    fit: Annotated[
        str,
        typer.Argument(
            metavar="FIT|RIG", help="A fit that match wrote, .toml; or a bundled rig as it is."
        ),
    ],
    recordings: RecordingsArgument,
    noise: NoiseOption = None,
    healthy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RECORDING",
            help="A recording in which nothing happened, such as one of the match; may be "
            "repeated. From them follows how sure the diagnosis may be.",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A fault that is looked for, such as 'loosen P1'; may be repeated. Otherwise all "
            "usual ones.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="A folder for pictures, .png.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find which fault explains what changes in a rig: its name, since when, how large, and how
    likely; or that none of them does.

    The exit code is 5 where something changed.
    """
    from ..diagnosis import diagnose as diagnosed
    from ..matching import Fit
    from ..observers import ProcessNoise
    from ..physics import Twin
    from ..rig import bundled_rigs

    check_folder(out)
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        loaded = Twin(fit) if fit in bundled_rigs() else Fit.load(fit)
        rig = loaded.rig if isinstance(loaded, Twin) else loaded.twin.rig
        experiments, gaps = open_continuous(rig, recordings)
        known = open_continuous(rig, healthy)[0] if healthy else None
        levels = None if noise is None else ProcessNoise.load(noise)
        result: list[Diagnosis] = []
        for recording in experiments:
            progress.step(f"diagnosing {recording.name}")
            result.append(diagnosed(loaded, recording, fault or None, levels, healthy=known))
        if out is not None:
            progress.step(f"drawing into {out}")
            names = [experiment.name or number for number, experiment in enumerate(experiments, 1)]
            plots = (diagnosis.plot() for diagnosis in result)
            write_pictures(out, zip(map(str, names), plots, strict=True))
    say("\n".join([*gaps, *(diagnosis.summary() for diagnosis in result)]), json)
    say_written(out, json_path=json)
    write_json(json, {"recordings": [diagnosis.to_dict() for diagnosis in result]})
    if any(diagnosis.causes for diagnosis in result):
        raise typer.Exit(ALARMED)
