"""`jaxtwin export`: a recording of a live rig on an even grid."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import JsonOption, OverwriteOption
from ._output import check_json, check_new_output, say, write_json
from ._show_progress import show_progress


def export(
    recording: Annotated[Path, typer.Argument(metavar="FILE", help="What 'record' wrote.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Where to: .nc or .csv.")],
    step: Annotated[float, typer.Option(metavar="S", help="Of the time grid.")] = 1.0,
    start: Annotated[
        float | None, typer.Option(metavar="S", help="Leave out what was before.")
    ] = None,
    end: Annotated[float | None, typer.Option(metavar="S", help="Leave out what is after.")] = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = None,
) -> None:
    """Put a recording of a live rig on an even time grid; gaps stay gaps."""
    from ..io import Session, write_recording

    check_new_output(out, overwrite, ".nc", ".csv")
    check_json(json)
    with show_progress() as progress:
        progress.step(f"reading {recording}")
        with Session(recording) as session:
            experiment = session.experiment(step=step, start=start, end=end)
        progress.step(f"writing {out}")
        write_recording(experiment, out)
    gaps = experiment.gaps.tolist()
    lines = [f"{out}: {len(experiment.time)} samples in {experiment.duration:g} s"]
    lines += [f"  nothing from {before:g} s to {after:g} s" for before, after in gaps]
    say("\n".join(lines), json)
    write_json(json, {"samples": len(experiment.time), "gaps_s": gaps})
