"""`jaxtwin observe`: what a rig is doing, by an observer, and what is expected of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._exit_codes import ALARMED
from ._monitored import CalibrationOption, MonitorOptions, SampleTimeOption
from ._options import (
    AnyAlarmOption,
    BaudOption,
    DurationOption,
    NoiseOption,
    ParameterFileOption,
    ReplaySpeedOption,
    SetOption,
    WatchedArgument,
    WatchedLinkOption,
)
from ._output import check_output
from ._sources import label_of, open_twin
from ._watch import show

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..live import Finding, RecordConsumer
    from ..rig import Rig


def observe(
    source: WatchedArgument,
    link: WatchedLinkOption = None,
    noise: NoiseOption = None,
    sample_time: SampleTimeOption = 1.0,
    calibration: CalibrationOption = None,
    alarm: AnyAlarmOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Record, with the estimates beside the readings, .db."),
    ] = None,
    speed: ReplaySpeedOption = 1.0,
    duration: DurationOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Show what an observer says of a live rig or a recording: channels, what was expected of them
    and what is in a minute, temperatures that nothing measures, the room, and unexplained heat.

    A monitor tests each reading. What it finds is in the line of the last event; an alarm is also
    in the log, and runs the command that --alarm names. The exit code is 5 where there was one.
    With --out a live rig is recorded, and what the observer estimates once a second, in a table of
    its own.
    """
    from ..live import Screen

    def make_screen(
        rig: "Rig", on_finding: "Callable[[Finding], None]"
    ) -> "tuple[Screen, list[RecordConsumer]]":
        twin = open_twin(rig, set_name, parameter_file)
        monitor = MonitorOptions(noise, calibration, sample_time).monitor(twin, on_finding)
        return Screen(twin, monitor.observer, monitor.follower), [monitor]

    if out is not None and not link:
        raise typer.BadParameter("--out records a live rig, with --link; a recording is there")
    check_output(out, ".db")
    if show(
        source, link or [], make_screen, speed, duration, baud, alarm, out, label_of(parameter_file)
    ):
        raise typer.Exit(ALARMED)
