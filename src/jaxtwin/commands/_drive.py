"""`jaxtwin drive`: a duty schedule on a live rig."""

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from ._options import BaudOption, LinkOption, RigArgument
from ._output import check_output, say
from ._show_progress import show_progress
from ._signals import stop_signals


def drive(
    rig: RigArgument,
    link: LinkOption,
    duty: Annotated[
        str,
        typer.Option(
            metavar="SCHEDULE",
            help="Duty cycles from given times on, s: 0:0.5,500:0.78; for each cell: 0:0.5/0.3.",
        ),
    ],
    duration: Annotated[
        float, typer.Option(metavar="S", help="Of the schedule, in the time of the rig.")
    ] = 1000.0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Record at the same time, .db.")
    ] = None,
    silence: Annotated[
        float, typer.Option(min=0.1, metavar="S", help="Stop after so long without data.")
    ] = 3.0,
    baud: BaudOption = 115_200,
) -> None:
    """Drive a live rig; the cells are off afterwards, whatever happens."""
    from ..io import Experiment
    from ..live import Recorder, connect, opener
    from ..live import drive as run_plan
    from ..rig import load_rig

    check_output(out, ".db")
    with stop_signals() as stop, show_progress() as progress, contextlib.ExitStack() as stack:
        loaded = load_rig(rig)
        plan = Experiment.schedule(duty, duration=duration, cells=len(loaded.cells))
        for url in link:  # what cannot be a link is refused before there is a file
            opener(url, baud=baud)
        recorder = stack.enter_context(Recorder(out, loaded)) if out else None
        bench = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        progress.step(f"driving {loaded.name} for {duration:g} s")

        def tell(time: float, pwm: tuple[int, ...]) -> None:
            parts = ", ".join(f"{100 * count / loaded.driver.counts:.0f} %" for count in pwm)
            progress.update(f"{time:.0f} s, duty {parts}")

        run_plan(bench, loaded, plan, silence=silence, stop=stop, progress=tell)
    say("the cells are off")
