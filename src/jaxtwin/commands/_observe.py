"""`jaxtwin observe`: what a rig is doing, by an observer, and what is expected of it."""

from typing import TYPE_CHECKING

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
from ._sources import open_twin
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
    """
    from ..live import Screen

    def made(
        rig: "Rig", on_finding: "Callable[[Finding], None]"
    ) -> "tuple[Screen, list[RecordConsumer]]":
        twin = open_twin(rig, set_name, parameter_file)
        monitor = MonitorOptions(noise, calibration, sample_time).monitor(twin, on_finding)
        return Screen(twin, monitor.observer, monitor.follower), [monitor]

    if show(source, link or [], made, speed, duration, baud, alarm):
        raise typer.Exit(ALARMED)
