"""`jaxtwin diagnose`: which fault explains what changes in recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._errors import JaxtwinError
from .._whole_file import write_whole_file
from ._options import JsonOption, NoiseOption, RecordingsArgument
from ._output import check_json, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_recordings

if TYPE_CHECKING:
    from ..diagnosis import Diagnosis

CHANGED = 5
"""The exit code if something changed."""


def diagnose(
    fit: Annotated[Path, typer.Argument(metavar="FIT", help="A fit that match wrote, .toml.")],
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

    if out is not None and out.exists() and not out.is_dir():
        raise typer.BadParameter(f"--out {out}: expected a folder, got a file")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        loaded = Fit.load(fit)
        rig = loaded.twin.rig
        experiments = open_recordings(rig, recordings)
        known = open_recordings(rig, healthy) if healthy else None
        levels = None if noise is None else ProcessNoise.load(noise)
        found: list[Diagnosis] = []
        for one in experiments:
            progress.step(f"diagnosing {one.name}")
            found.append(diagnosed(loaded, one, fault or None, levels, healthy=known))
        if out is not None:
            progress.step(f"drawing into {out}")
            _draw(out, found)
    say("\n".join(one.summary() for one in found), json)
    say_written(out, json_path=json)
    write_json(json, {"recordings": [one.to_dict() for one in found]})
    if any(one.causes for one in found):
        raise typer.Exit(CHANGED)


def _draw(folder: Path, found: "list[Diagnosis]") -> None:
    from ..plots import to_png

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise typer.BadParameter(f"--out {folder}: {error.strerror}") from None
    for number, one in enumerate(found, 1):
        name = f"{one.experiment.name or number}.png".replace("/", "-")
        write_whole_file(folder / name, to_png(one.plot()), JaxtwinError)
