"""A run on a live rig: the part that `drive`, `control` and `prove` have in common."""

import contextlib
import getpass
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ._alarm_command import AlarmCommand
from ._monitored import MonitorOptions, ring_and_note
from ._output import check_output, say
from ._show_progress import show_progress
from ._signals import stop_signals
from ._sources import open_twin

if TYPE_CHECKING:
    from ..live import AbstractInterlock
    from ..physics import Twin

Run = Callable[..., Literal["completed", "stopped"]]
"""A function that commands a rig. Its arguments are the connection and the keywords `reset`,
`about`, `stop`, `on_progress` and `on_alarm`, and `consumers` if there is a monitor."""


def run_on_live_rig(
    prepare: "Callable[[Twin, Sequence[AbstractInterlock]], tuple[Run, Mapping[str, Any]]]",
    *,
    rig: str,
    link: Sequence[str],
    doing: str,
    duration: float | None,
    out: Path | None,
    reset: bool,
    alarm: str | None,
    operator: str | None,
    parameter_file: Path | None,
    set_name: str | None,
    baud: int,
    monitor: MonitorOptions | None = None,
) -> bool:
    """Connects to a rig, commands it, and says when the cells are off.

    **Arguments:**

    - `prepare`: a function of the twin, and of interlocks beside the usual ones, that returns the
      `Run`, and the data that the recording stores beside operator and command line. It is called
      before a connection is opened or a file is created, so that an error in it leaves neither
      behind, and that what it compiles does not keep a rig waiting.
    - `doing`: the word for the run in the progress, such as `"driving"`.
    - `duration`: the duration of the run, s; `None` if nobody knows it.
    - `monitor`: how the rig is monitored; None: not at all. Its alarms switch the rig off where
      the rig file says so.
    - the others: the options of the command.

    **Returns:** whether there was an alarm.

    **Raises:** `SafetyStop` if an interlock trips or a signal other than Ctrl-C ends the run;
    `KeyboardInterrupt` after Ctrl-C, with the cells off and the recording closed.
    """
    from ..live import AlarmInterlock, Finding, Recorder, connect, opener
    from ..live.protocol._mqtt_address import without_password
    from ..rig import load_rig

    check_output(out, ".db")
    with stop_signals() as stop, show_progress() as progress, contextlib.ExitStack() as stack:
        loaded = load_rig(rig)
        twin = open_twin(loaded, set_name, parameter_file)
        interlock = AlarmInterlock()
        is_stopped_by_alarm = loaded.limits is not None and loaded.limits.stop_on_alarm
        run, about = prepare(twin, [interlock] if is_stopped_by_alarm else [])

        def found(finding: Finding) -> None:
            interlock.ring(finding)
            ring_and_note(connection, command, finding)

        if monitor is not None:
            progress.step("compiling the monitor")
            run = partial(run, consumers=[monitor.monitor(twin, found)])
        for url in link:  # an invalid link is refused before a file is created
            opener(url, loaded, baud=baud)
        command = stack.enter_context(AlarmCommand(alarm))
        recorder = stack.enter_context(Recorder(out, loaded)) if out else None
        connection = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        length = "" if duration is None else f" for {duration:g} s"
        progress.step(f"{doing} {loaded.name}{length}")

        def show(time: float, pwm: tuple[int, ...]) -> None:
            duty = ", ".join(f"{100 * part:.0f} %" for part in loaded.driver.duty(pwm))
            progress.update(f"{time:.0f} s, duty {duty}")

        outcome = run(
            connection,
            reset=reset,
            about={
                **about,
                "operator": operator or getpass.getuser(),
                "command": shlex.join(["jaxtwin", *map(without_password, sys.argv[1:])]),
            },
            stop=stop,
            on_progress=show,
            on_alarm=command.ring,
        )
    if outcome == "stopped":
        raise KeyboardInterrupt  # exit code 130
    say("the cells are off")
    return command.rung
