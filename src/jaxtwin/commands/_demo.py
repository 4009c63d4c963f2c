"""`jaxtwin demo`: the paper's rig simulated, matched and analysed, as a report."""

from pathlib import Path
from typing import Annotated

import typer

from ._show_progress import show_progress


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The report's folder.")] = Path(
        "report"
    ),
    recordings: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the authors' recordings lie; else looked for."),
    ] = None,
    draws: Annotated[
        int, typer.Option(min=50, help="Of the larger sensitivity analysis.")
    ] = 10_000,
) -> None:
    """Simulate, match and analyse the paper's rig; write a report with pictures and numbers."""
    from ..report import write_demo

    with show_progress() as progress:
        page = write_demo(out, recordings=recordings, draws=draws, progress=progress)
    print(page)
