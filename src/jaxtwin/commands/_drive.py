"""`jaxtwin drive`: a duty schedule on a live rig."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._exit_codes import ALARMED
from ._live_run import Run, run_on_live_rig
from ._monitored import CalibrationOption, MonitorOption, MonitorOptions, SampleTimeOption
from ._options import (
    AcceptOption,
    AlarmOption,
    AmbientOption,
    BaudOption,
    DatabaseOption,
    LinkOption,
    NoiseOption,
    OperatorOption,
    ParameterFileOption,
    ResetOption,
    RigArgument,
    SetOption,
    SilenceOption,
)
from ._sources import open_recordings

if TYPE_CHECKING:
    from ..live import AbstractInterlock, Draws
    from ..physics import Twin


def drive(
    rig: RigArgument,
    link: LinkOption,
    duty: Annotated[
        str | None,
        typer.Option(
            metavar="SCHEDULE",
            help="Duty cycles from given times on, s: 0:0.5,500:0.78; for each cell: 0:0.5/0.3.",
        ),
    ] = None,
    duration: Annotated[
        float, typer.Option(metavar="S", help="Of the schedule, in the time of the rig.")
    ] = 1000.0,
    plan: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="In place of --duty: the duty cycles of a file, such as one of 'jaxtwin design', "
            "or of a recording.",
        ),
    ] = None,
    out: DatabaseOption = None,
    silence: SilenceOption = 3.0,
    ambient: AmbientOption = None,
    monitor: MonitorOption = False,
    noise: NoiseOption = None,
    calibration: CalibrationOption = None,
    sample_time: SampleTimeOption = 1.0,
    accept: AcceptOption = False,
    reset: ResetOption = False,
    alarm: AlarmOption = None,
    operator: OperatorOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Drive a live rig by a schedule of duty cycles or by a plan, then switch the cells off.

    The cells are also switched off after an error. Then the readings are watched until they show
    that the rig cools, for a minute at most; Ctrl-C ends that. The exit code is 0 after the whole
    schedule, 3 if an interlock or a signal such as SIGTERM stopped it, 5 after an alarm, also if
    the device reported heat after the stop (cut the power), 6 if the rig heats afterwards whatever
    the device reports (cut the power), 130 after Ctrl-C.

    With --monitor, what changes in the rig is an alarm: in the log, in the recording, and by the
    command that --alarm names. It switches the cells off if the rig file says so
    (limits.stop_on_alarm), and there is always a monitor then.
    """

    if (duty is None) == (plan is None):
        raise typer.BadParameter("give either --duty or --plan")
    recorded = None
    if plan is not None:
        from ..rig import load_rig

        (recorded,) = open_recordings(load_rig(rig), [plan])
        duration = recorded.duration

    def prepare(
        twin: "Twin", draws: "Draws | None", interlocks: "Sequence[AbstractInterlock]"
    ) -> tuple[Run, Mapping[str, Any]]:
        from ..io import Experiment
        from ..live import Guard, interlocks_of
        from ..live import drive as run_plan

        cells = len(twin.rig.driven)
        schedule = recorded or Experiment.schedule(duty or "", duration=duration, cells=cells)
        source = {"duty": duty} if plan is None else {"file": plan}
        about = {"plan": {**source, "duration_s": duration}}
        usual = interlocks_of(twin, silence=silence, ambient=ambient, draws=draws)
        guard = Guard([*usual, *interlocks])
        if not accept:  # before the rig is connected
            guard.check_plan(schedule)
        return partial(run_plan, guard=guard, plan=schedule, accept=True), about

    alarmed = run_on_live_rig(
        prepare,
        doing="driving",
        duration=duration,
        rig=rig,
        link=link,
        out=out,
        reset=reset,
        alarm=alarm,
        operator=operator,
        parameter_file=parameter_file,
        set_name=set_name,
        baud=baud,
        monitor=MonitorOptions.of(monitor, noise, calibration, sample_time, rig),
    )
    if alarmed:
        raise typer.Exit(ALARMED)
