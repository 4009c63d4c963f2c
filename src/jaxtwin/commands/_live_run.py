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
from ._sources import open_draws, open_twin
from ._unblocked_output import unblocked_output

if TYPE_CHECKING:
    from ..live import AbstractInterlock, Draws
    from ..physics import Twin

Run = Callable[..., Literal["completed", "stopped"]]
"""A function that commands a rig. Its arguments are the connection and the keywords `reset`,
`about`, `stop`, `on_progress`, `on_alarm` and `on_end`, and `consumers` if there is a monitor."""

Prepare = Callable[
    ["Twin", "Draws | None", "Sequence[AbstractInterlock]"], tuple[Run, Mapping[str, Any]]
]


def run_on_live_rig(
    prepare: "Prepare",
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
    """Connects to a rig, commands it, and says at the end whether it is off.

    **Arguments:**

    - `prepare`: a function of the twin, of draws of its parameters if its fit is known, and of
      interlocks beside the usual ones, that returns the `Run`, and the data that the recording
      stores beside operator and command line. It is called before a connection is opened or a file
      is created, so that an error in it leaves neither behind, and that what it compiles does not
      keep a rig waiting.
    - `doing`: the word for the run in the progress, such as `"driving"`.
    - `duration`: the duration of the run, s; `None` if nobody knows it.
    - `monitor`: how the rig is monitored; None: not at all. Its alarms switch the rig off where
      the rig file says so.
    - the others: the options of the command.

    **Returns:** whether there was an alarm.

    **Raises:** `SafetyStop` if an interlock trips or a signal other than Ctrl-C ends the run;
    `KeyboardInterrupt` after Ctrl-C, with the cells off and the recording closed.
    """
    from ..errors import SafetyStop
    from ..live import (
        STILL_HEATS,
        STILL_ON,
        AlarmInterlock,
        Ending,
        Finding,
        Recorder,
        connect,
        opener,
        without_password,
    )
    from ..rig import load_rig

    check_output(out, ".db")
    with (
        stop_signals() as stop,
        unblocked_output(),
        show_progress() as progress,
        contextlib.ExitStack() as stack,
    ):
        loaded = load_rig(rig)
        twin = open_twin(loaded, set_name, parameter_file)
        draws = open_draws(loaded, parameter_file)
        interlock = AlarmInterlock()
        is_stopped_by_alarm = loaded.limits is not None and loaded.limits.stop_on_alarm
        run, about = prepare(twin, draws, [interlock] if is_stopped_by_alarm else [])
        endings: list[Ending] = []

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

        def ended(ending: Ending) -> None:
            if not endings and ending.off:
                progress.step(f"{ending}; watching the readings until they show it")
            endings.append(ending)

        try:
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
                on_end=ended,
            )
        except SafetyStop as error:
            # A signal is not an alarm, nor a rig that did not start, and what the device or the
            # readings show after a stop has been raised already.
            if endings and error.kind not in (
                "signal",
                "stopped",
                "not-ready",
                STILL_ON,
                STILL_HEATS,
            ):
                command.ring(Finding(error.kind, str(error), severity="critical"))
            raise
        if endings:
            say(str(endings[-1]))
    if outcome == "stopped":
        raise KeyboardInterrupt  # exit code 130
    return command.rung
