"""`jaxtwin record`: a live rig into a file."""

import contextlib
import datetime
import hashlib
import json
import json as json_text
import os
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, final

import typer

from .._celsius import ZERO_CELSIUS
from .._whole_file import write_whole_file
from ..errors import JaxtwinError
from ._alarm_command import AlarmCommand
from ._exit_codes import ALARMED
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
from ._show_progress import show_progress
from ._signals import stop_signals
from ._sources import open_twin
from ._unblocked_output import unblocked_output

if TYPE_CHECKING:
    from ..live import Recorder, RigConnection
    from ..rig import Rig


# Time between two heartbeats, s.
INTERVAL_SECONDS = 1.0


@final
class Heartbeat:
    """Reports to systemd (`NOTIFY_SOCKET`, `Type=notify`) and in a health file that the command is
    alive.

    **Arguments:**

    - `file`: a JSON file with the time and the state, replaced as a whole once a second; or None.
    """

    def __init__(self, file: Path | None):
        self._file = file
        self._last = 0.0
        self._address = os.environ.get("NOTIFY_SOCKET", "")

    def ready(self) -> None:
        """Reports that the command has started its work."""
        self._notify("READY=1")

    def beat(self, content: dict[str, Any]) -> None:
        """Called in every turn of the loop; reports once a second."""
        if time.monotonic() - self._last < INTERVAL_SECONDS:
            return
        self._last = time.monotonic()
        self._notify("WATCHDOG=1")
        if self._file is not None:
            text = json.dumps({"time": time.time(), **content})
            # The recorder reports a full disk.
            with contextlib.suppress(JaxtwinError):
                write_whole_file(self._file, text.encode(), JaxtwinError)

    def _notify(self, text: str) -> None:
        if not self._address:
            return
        address = self._address.replace("@", "\0", 1)  # an abstract socket
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor,
        ):
            supervisor.sendto(text.encode(), address)


@final
class RecordedDays:
    """The recorder of the present day, as a context manager.

    **Arguments:**

    - `out`: the file; with `daily` the day (UTC) is added to its name.
    - `rig`, `append`, `keep_frames`: as for `Recorder`. A file of the present day is continued.
    - `daily`: begin a new file at midnight, and write the checksum of the file before.
    """

    def __init__(self, out: Path, rig: "Rig", *, daily: bool, append: bool, keep_frames: bool):
        self._out, self._rig, self._daily = out, rig, daily
        self._append, self._keep_frames = append, keep_frames
        self._day = self._today()
        self.file = self._named(self._day)
        self.recorder: Recorder = self._opened()

    def __enter__(self) -> "RecordedDays":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        self.recorder.__exit__(kind, error, where)

    def turn(self, connection: "RigConnection") -> None:
        """Begins the next day's file after midnight."""
        today = self._today()
        if not self._daily or today == self._day:
            return
        ended, before = self.file, self.recorder
        self._day, self.file = today, self._named(today)
        self.recorder = self._opened()
        connection.record_into(self.recorder)
        before.close("the day is over")
        with ended.open("rb") as stream:
            checksum = hashlib.file_digest(stream, "sha256").hexdigest()
        beside = ended.with_name(ended.name + ".sha256")
        beside.write_text(f"{checksum}  {ended.name}\n", encoding="utf-8")

    def _opened(self) -> "Recorder":
        from ..live import Recorder

        append = self._append or (self._daily and self.file.exists())
        return Recorder(self.file, self._rig, append=append, keep_frames=self._keep_frames)

    def _today(self) -> str:
        return datetime.datetime.now(datetime.UTC).date().isoformat()

    def _named(self, day: str) -> Path:
        if not self._daily:
            return self._out
        return self._out.with_name(f"{self._out.stem}-{day}{self._out.suffix}")


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
