"""`jaxtwin record`: a live rig into a file."""

import contextlib
import json as json_text
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from .._celsius import ZERO_CELSIUS
from ._alarm_command import AlarmCommand
from ._exit_codes import ALARMED
from ._heartbeat import Heartbeat
from ._monitored import (
    CalibrationOption,
    MonitorOption,
    MonitorOptions,
    SampleTimeOption,
    ring_and_note,
)
from ._options import (
    AnyAlarmOption,
    BaudOption,
    DurationOption,
    JsonOption,
    LinkOption,
    NoiseOption,
    ParameterFileOption,
    PublishOption,
    QuietOption,
    RigArgument,
    SetOption,
)
from ._output import check_json, check_output, say, write_json
from ._recorded_days import RecordedDays
from ._show_progress import show_progress
from ._signals import stop_signals
from ._sources import open_twin
from ._unblocked_output import unblocked_output


def record(
    rig: RigArgument,
    link: LinkOption,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The recording, .db.")],
    append: Annotated[bool, typer.Option("--append", help="Go on with a recording.")] = False,
    frames: Annotated[bool, typer.Option("--frames", help="Keep camera frames too.")] = False,
    daily: Annotated[
        bool,
        typer.Option("--daily", help="A file for each day (UTC), FILE-2026-01-31.db, checksummed."),
    ] = False,
    duration: DurationOption = None,
    publish: PublishOption = None,
    alarm: AnyAlarmOption = None,
    monitor: MonitorOption = False,
    noise: NoiseOption = None,
    calibration: CalibrationOption = None,
    sample_time: SampleTimeOption = 1.0,
    silence: QuietOption = 10.0,
    health: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON, new every second.")
    ] = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
    json: JsonOption = None,
) -> None:
    """Record a live rig until Ctrl-C.

    Temperatures above the rig's limit, silence, failed channels, lost links and a disk that is
    nearly full are alarms: a line in the log, an event in the recording and on MQTT, and the
    command that --alarm names. With --monitor, so is what changes in the rig. The exit code is 5
    where there was one.
    """
    from ..io import Session
    from ..live import (
        Alarms,
        Finding,
        Publisher,
        RecordConsumer,
        Service,
        connect,
        opener,
        report,
        state_as_json,
    )
    from ..rig import load_rig

    check_output(out, ".db")
    check_json(json)
    check_output(health, option="--health")
    options = MonitorOptions.of(monitor, noise, calibration, sample_time, rig, is_driven=False)
    with (
        stop_signals() as stop,
        unblocked_output(),
        show_progress() as progress,
        contextlib.ExitStack() as stack,
    ):
        loaded = load_rig(rig)
        for url in link:  # an invalid link is refused before a file is created
            opener(url, loaded, baud=baud)

        def ring(finding: Finding) -> None:
            ring_and_note(connection, command, finding)
            if publisher is not None:
                publisher.send_finding(finding)

        consumers: list[RecordConsumer] = []
        if options is not None:
            progress.step("compiling the monitor")
            twin = open_twin(loaded, set_name, parameter_file)
            consumers.append(options.monitor(twin, ring))
        names = [channel.name for channel in loaded.channels]
        publisher = None
        if publish is not None:
            publisher = stack.enter_context(contextlib.closing(Publisher(publish, loaded)))
            consumers.append(publisher)
        days = stack.enter_context(
            RecordedDays(out, loaded, daily=daily, append=append, keep_frames=frames)
        )
        command = stack.enter_context(AlarmCommand(alarm))
        connection = stack.enter_context(connect(loaded, *link, journal=days.recorder, baud=baud))
        limit = loaded.maximum_temperature
        hottest = None if limit is None else limit - ZERO_CELSIUS

        alarms = Alarms(names, hottest, silence, out, connection.clock.now(), ring)
        service = Service(connection, [alarms, *consumers])
        heartbeat = Heartbeat(health)
        heartbeat.ready()
        progress.step(f"recording into {days.file} until Ctrl-C")
        begin = time.monotonic()
        while not stop.is_set() and (duration is None or time.monotonic() - begin < duration):
            service.turn()
            days.turn(connection)
            links = [str(state) for state in connection.states.values()]
            written = days.recorder.written
            heartbeat.beat({"records": written, **state_as_json(service.state, loaded)})
            progress.update(f"{written} records, link {' and '.join(links)}")
    with Session(days.file) as session:
        content = report(session)
    say(_table(days.file, content), json)
    write_json(json, content)
    if command.rung:
        raise typer.Exit(ALARMED)


def _table(file: Path, content: dict[str, Any]) -> str:
    lines = [f"{file}: {content['rig']}"]
    lines += [
        "  {stream} from {link}: {count}, every {period:.3g} s, longest step {longest:.3g} s, "
        "clock {drift:+.0f} ppm, late by {wait_99:.2g} s (99 %)".format(**stream)
        for stream in content["streams"]
    ]
    lines += [f"  lost: {count} of {stream}" for stream, count in content["lost"].items()]
    lines += [f"  {kind}: {count}" for kind, count in content["events"].items()]
    lines += [
        f"  driven by {drive['operator'] or drive['owner']}: {json_text.dumps(drive['plan'])}, "
        f"{drive['status']} {drive['reason']}".rstrip()
        for drive in content["drives"]
    ]
    return "\n".join(lines)
