"""`jaxtwin control`: a controller on a live rig."""

import contextlib
import getpass
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from ._options import BaudOption, LinkOption, ParametersOption, RigArgument, SetOption
from ._output import check_output, say
from ._show_progress import show_progress
from ._signals import stop_signals
from ._sources import open_twin


def control(
    rig: RigArgument,
    link: LinkOption,
    controller: Annotated[
        Path, typer.Option("--controller", metavar="FILE", help="A controller file, .toml.")
    ],
    reference: Annotated[
        str,
        typer.Option(
            metavar="SCHEDULE",
            help="Temperatures from given times on, s and degC: 0:35,600:45; for each output: "
            "0:35/37.",
        ),
    ],
    duration: Annotated[float, typer.Option(metavar="S", help="In the time of the rig.")] = 1000.0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Record at the same time, .db.")
    ] = None,
    silence: Annotated[
        float, typer.Option(min=0.1, metavar="S", help="Stop after so long without data.")
    ] = 3.0,
    reset: Annotated[
        bool, typer.Option("--reset", help="End a trip of the device first. Look why it tripped.")
    ] = False,
    operator: Annotated[
        str | None, typer.Option(metavar="NAME", help="Kept in the recording; the user's name.")
    ] = None,
    parameters: ParametersOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Control a live rig by a controller from a file, then switch the cells off.

    The cells are also switched off after an error. The exit code is 0 after the whole time, 3 if an
    interlock stopped it, 130 after Ctrl-C.
    """
    from ..control import control as run_controller
    from ..control import read_controller
    from ..live import Guard, Recorder, connect, opener
    from ..rig import load_rig

    check_output(out, ".db")
    with stop_signals() as stop, show_progress() as progress, contextlib.ExitStack() as stack:
        loaded = load_rig(rig)
        twin = open_twin(loaded, set_name, parameters)
        chosen = read_controller(controller, loaded)
        # Compiled now: a rig that is connected sends, and nobody would listen.
        Guard(twin, "", silence=silence)
        for url in link:  # what cannot be a link is refused before there is a file
            opener(url, baud=baud)
        recorder = stack.enter_context(Recorder(out, loaded)) if out else None
        bench = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        progress.step(f"controlling {loaded.name} for {duration:g} s")

        def tell(time: float, pwm: tuple[int, ...]) -> None:
            parts = ", ".join(f"{100 * count / loaded.driver.counts:.0f} %" for count in pwm)
            progress.update(f"{time:.0f} s, duty {parts}")

        outcome = run_controller(
            bench,
            twin,
            chosen,
            reference,
            duration_s=duration,
            silence=silence,
            reset=reset,
            about={
                "plan": {"reference": reference, "duration_s": duration},
                "controller": controller.read_text(encoding="utf-8"),
                "operator": operator or getpass.getuser(),
                "command": shlex.join(["jaxtwin", *sys.argv[1:]]),
            },
            stop=stop,
            progress=tell,
        )
    if outcome == "stopped":
        raise KeyboardInterrupt  # exit code 130, with the cells off and the journal closed
    say("the cells are off")
