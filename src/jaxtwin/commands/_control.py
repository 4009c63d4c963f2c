"""`jaxtwin control`: a controller on a live rig."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
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
from ._output import say

if TYPE_CHECKING:
    from ..control import Decision, LiveLoop
    from ..live import AbstractInterlock, Draws
    from ..physics import Twin


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
            "0:35/37; reached slowly: 0:16,ramp 600:40, or smoothly: 0:16,curve 600:40.",
        ),
    ],
    duration: Annotated[float, typer.Option(metavar="S", help="In the time of the rig.")] = 1000.0,
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
    """Control a live rig by a controller from a file, then switch the cells off.

    The cells are also switched off after an error. Then the readings are watched until they show
    that the rig cools, for a minute at most; Ctrl-C ends that. The exit code is 0 after the whole
    time, 3 if an interlock or a signal such as SIGTERM stopped it, 5 after an alarm, also if the
    device reported heat after the stop (cut the power), 6 if the rig heats afterwards whatever the
    device reports (cut the power), 130 after Ctrl-C. --monitor is as for drive.

    Prints how far from instability the loop is before it begins, and after it the temperature
    limits that the controller could not keep. After a relay, prints the ultimate
    gain and period of its oscillation, and the fields of a PID from them. The exit code is 2 if the
    plate did not oscillate evenly.
    """
    decisions: list[Decision] = []
    loops: list[LiveLoop] = []

    def prepare(
        twin: "Twin", draws: "Draws | None", interlocks: "Sequence[AbstractInterlock]"
    ) -> tuple[Run, Mapping[str, Any]]:
        from ..control import LiveLoop, Relay, read_controller
        from ..control import control as run_controller
        from ..live import Guard, interlocks_of

        chosen = read_controller(controller, twin.rig)
        loop = LiveLoop(
            twin,
            chosen,
            reference,
            duration=duration,
            silence=silence,
            ambient=ambient,
        )
        loops.append(loop)
        if (margins := loop.margins()) is not None:
            say(margins.summary())
        usual = interlocks_of(twin, silence=silence, ambient=ambient, draws=draws)
        guard = Guard([*usual, *interlocks])
        if not accept:  # before the rig is connected
            hottest = guard.check_plan(loop.simulated_plan())
            if hottest is not None and hottest.is_near:
                say(
                    f"near the limit of {hottest.limit:g} degC: {hottest}, says the twin. A "
                    "healthy rig that needs more duty than its twin may be stopped; lower "
                    "references or a match to more days leave more room"
                )
        keep = decisions.append if isinstance(chosen, Relay) else None
        run = partial(run_controller, guard=guard, loop=loop, accept=True, on_decision=keep)
        about = {
            "plan": {"reference": reference, "duration_s": duration},
            "controller": controller.read_text(encoding="utf-8-sig"),
        }
        return run, about

    alarmed = run_on_live_rig(
        prepare,
        doing="controlling",
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
    for limit in (limit for loop in loops for limit in loop.exceeded):
        say(str(limit))
    if decisions:
        say(_oscillation(decisions))
    if alarmed:
        raise typer.Exit(ALARMED)


def _oscillation(decisions: "Sequence[Decision]") -> str:
    """Describes the critical point of a plate, and the PID by the rule of Tyreus and Luyben in the
    words of a controller file.

    **Raises:** `ControlError` if the oscillation is not even.
    """
    from ..control import PID, ultimate_point

    point = ultimate_point(decisions)
    pid = point.pid()
    result = (
        f"ultimate gain {point.gain:.3g} 1/K, period {point.period_s:.3g} s, phase "
        f"{point.phase_deg:.0f} degrees, by the last {point.cycles} periods"
    )
    gains = {name: PID.fields[name].unit for name in ("Kp", "Ki", "Kd", "Tf")}
    fields = [f'{name} = "{getattr(pid, name):.3g} {unit}"' for name, unit in gains.items()]
    return "\n".join([result, "a PID by the rule of Tyreus and Luyben:", *fields])
