"""`jaxtwin report`: a saved fit as a page."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import RecordingsArgument
from ._show_progress import show_progress
from ._sources import open_recordings


def report(
    fit: Annotated[Path, typer.Argument(metavar="FIT", help="A saved fit, .toml.")],
    recordings: RecordingsArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder of the report.")
    ] = Path("report"),
    draws: Annotated[
        int, typer.Option(min=0, help="Of a sensitivity analysis; 0 leaves it out.")
    ] = 0,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="RIG", help="The rig of the fit; by default the one with which it was made."
        ),
    ] = None,
) -> None:
    """Write a fit and its recordings as a page: parameters, pictures, residual tests."""
    from ..matching import Fit
    from ..report import write_report

    with show_progress() as progress:
        progress.step("reading fit and recordings")
        loaded = Fit.load(fit, rig=rig).twin.rig
        experiments = open_recordings(loaded, recordings)
        complete = Fit.load(fit, rig=loaded, experiments=experiments)
        page = write_report(complete, out, draws=draws, progress=progress)
    print(page)
