"""`jaxtwin fleet`: hundreds of rigs, watched from the topics of a broker."""

import contextlib
import threading
from pathlib import Path
from typing import Annotated

import typer

from ._alarm_command import AlarmCommand
from ._dask import dask_executor
from ._exit_codes import ALARMED
from ._options import DurationOption
from ._output import check_output
from ._serve import announce, check_extra
from ._signals import stop_signals
from ._unblocked_output import unblocked_output


def fleet(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FLEET", help="A file of a fleet, .toml; docs/deploy.md describes it."
        ),
    ],
    virtual: Annotated[
        bool,
        typer.Option("--virtual", help="Also publish a virtual rig for each one, to try it."),
    ] = False,
    speed: Annotated[
        float, typer.Option(min=0.1, max=20, help="Seconds of the virtual rigs in one.")
    ] = 1.0,
    faults: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RIG:WORDS",
            help="Faults of a virtual rig, as for virtual-rig: oven-1:loosen=P1@600/4. May be "
            "repeated.",
        ),
    ] = None,
    host: Annotated[str, typer.Option(help="The address on which it listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65_535, help="0 takes a free one.")] = 8000,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST", help="A further name in the address of the page, as for serve."
        ),
    ] = None,
    allow_control: Annotated[
        bool, typer.Option("--allow-control", help="Clients with the token may order refits.")
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the token there, for its owner alone to read."),
    ] = None,
    duration: DurationOption = None,
) -> None:
    """Watch the rigs of a fleet from the topics of a broker, until Ctrl-C: a page with the worst
    first, findings, alarms and metrics. The file is read again when it changes.

    The page only shows. With --allow-control, who has the token that is printed at the start may
    have the champion of a rig refitted. The exit code is 5 if there was an alarm.
    """
    check_extra("fleet")
    if (faults or speed != 1.0) and not virtual:
        raise typer.BadParameter("--faults and --speed are those of rigs with --virtual")
    check_output(token_file, option="--token-file")
    with stop_signals() as stop, unblocked_output(), contextlib.ExitStack() as stack:
        from ..fleet import Fleet, FleetFile, fleet_app, virtual_fleet_process
        from ..physics import Faults
        from ..serve import Access, WebServer, listening

        opened = stack.enter_context(contextlib.closing(listening(host, port)))
        told = FleetFile.read(file)
        known: dict[str, Faults] = {}
        for text in faults or ():
            rig, _, words = text.partition(":")
            if rig not in told.members:
                raise typer.BadParameter(f"--faults {text}: expected RIG:WORDS, a rig of {file}")
            known[rig] = Faults.parse(words)
        executor = None
        if told.dask is not None:
            executor = stack.enter_context(dask_executor(told.dask, f"{file}: dask"))
        if virtual:  # it compiles for as long as the fleet does
            stack.enter_context(virtual_fleet_process(file, speed, known))
        command = stack.enter_context(AlarmCommand(told.alarm))
        fleet = stack.enter_context(contextlib.closing(Fleet(file, command.ring, executor)))
        number = opened.getsockname()[1]
        access = Access.of(host, number, names=tuple(name or ()), allow_control=allow_control)
        stack.enter_context(WebServer(fleet_app(fleet, access), opened))
        announce(f"{f'[{host}]' if ':' in host else host}:{number}", access.token, token_file)
        if duration is not None:
            timer = threading.Timer(duration, stop.set)
            timer.daemon = True
            timer.start()
        fleet.run(stop.is_set)
    if command.rung:
        raise typer.Exit(ALARMED)
