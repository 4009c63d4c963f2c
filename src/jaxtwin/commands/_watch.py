"""`jaxtwin watch`: a rig in the terminal, its twin beside it."""

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ._alarm_command import AlarmCommand
from ._options import (
    BaudOption,
    DurationOption,
    NoiseOption,
    ParameterFileOption,
    ReplaySpeedOption,
    SetOption,
    WatchedArgument,
    WatchedLinkOption,
)
from ._output import say
from ._signals import stop_signals
from ._sources import open_twin

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..live import Finding, RecordConsumer, Recorder, Replay, RigConnection, Screen
    from ..rig import Rig

    MakeScreen = Callable[[Rig, Callable[[Finding], None]], tuple[Screen, list[RecordConsumer]]]
    """A function of a rig and of what is to be called with each finding. It returns the screen, and
    the consumers that get each record before the screen."""

# The time between two pictures, s: drawing takes longer than reading, and a person needs no more
# pictures.
REDRAW = 0.25


def watch(
    source: WatchedArgument,
    link: WatchedLinkOption = None,
    speed: ReplaySpeedOption = 1.0,
    duration: DurationOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    noise: NoiseOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Show a live rig or a recording, and the twin's prediction beside it.

    With --noise an observer reads the rig, and its estimates and forecasts have bands, as in
    'observe', which also tests the readings and records.
    """
    from ..live import Screen
    from ..observers import ProcessNoise, live_observer

    def make_screen(rig: "Rig", _: object) -> "tuple[Screen, list[RecordConsumer]]":
        twin = open_twin(rig, set_name, parameter_file)
        levels = None if noise is None else ProcessNoise.load(noise)
        return Screen(twin, None if levels is None else live_observer(twin, levels)), []

    show(source, link or [], make_screen, speed, duration, baud)


def show(
    source: str,
    links: list[str],
    make_screen: "MakeScreen",
    speed: float,
    duration: float | None,
    baud: int,
    alarm: str | None = None,
    out: Path | None = None,
    label: str = "",
) -> bool:
    """Shows a source in the terminal until it ends, a signal arrives or the time is over.

    A live rig is recorded into `out`, with what the screen's observer estimates by the twin that
    `label` names.

    **Returns:** whether there was an alarm. Each runs the command `alarm`, and is an event that the
    screen shows.
    """
    from rich.live import Live

    from ..live import EstimateJournal, Event, Recorder, RigConnection, Service

    new_findings: list[Finding] = []
    with stop_signals() as stop, contextlib.ExitStack() as stack:
        command = stack.enter_context(AlarmCommand(alarm))
        rig = _rig(source, links)
        # This compiles, which takes a second, before the link is opened: nobody would read it.
        screen, first_consumers = make_screen(rig, new_findings.append)
        recorder = None
        if out is not None:
            recorder = stack.enter_context(Recorder(out, rig, append=out.exists()))
        connection = stack.enter_context(_source(source, rig, links, speed, baud, recorder))
        consumers: list[RecordConsumer] = [*first_consumers, screen]
        if recorder is not None and isinstance(connection, RigConnection):
            consumers.append(EstimateJournal(connection.note, lambda: (screen.follower, label)))
        service = Service(connection, consumers)
        live = stack.enter_context(Live(screen.render(), refresh_per_second=1 / REDRAW))
        begin = shown = time.monotonic()
        while not (stop.is_set() or connection.ended):
            service.turn()
            for finding in new_findings:
                if finding.is_alarm:
                    command.ring(finding)
                kind = "alarm" if finding.is_alarm else "notice"
                event = Event("", connection.clock.now(), kind, f"{finding.kind}: {finding}")
                if isinstance(connection, RigConnection):
                    connection.note(event)
                else:
                    screen.on_record(event, service.state)
            new_findings.clear()
            now = time.monotonic()
            if now - shown >= REDRAW:
                shown = now
                live.update(screen.render())
            if duration is not None and now - begin >= duration:
                break
        live.update(screen.render())
    if not live.console.is_terminal:
        say("")  # ends the last line, as rich does on a terminal
    return command.rung


def _rig(source: str, links: list[str]) -> "Rig":
    from ..io import Session
    from ..rig import load_rig

    if links:
        return load_rig(source)
    if not Path(source).is_file():
        raise typer.BadParameter(
            f"{source}: no such recording; a rig is watched with --link, "
            "socket://127.0.0.1:7000 say"
        )
    with Session(source) as session:
        return session.rig


def _source(
    source: str, rig: "Rig", links: list[str], speed: float, baud: int, recorder: "Recorder | None"
) -> "RigConnection | Replay":
    from ..live import Replay, connect

    if links:
        return connect(rig, *links, journal=recorder, baud=baud)
    return Replay(source, speed=speed)
