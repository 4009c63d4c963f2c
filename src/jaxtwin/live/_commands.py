"""Commands of the live rig: record, export, drive, virtual-rig, watch.

`add_commands` hangs them into the command line. What they need is imported when they run.
"""

import contextlib
import json
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from .._errors import JaxtwinError

Links = Annotated[
    list[str],
    typer.Option(
        "--link",
        help="socket://HOST:PORT, a serial port, rfc2217://HOST:PORT or mqtt://HOST/TOPIC; "
        "several for several devices.",
    ),
]
Baud = Annotated[int, typer.Option(help="Of serial ports.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
RigName = Annotated[str, typer.Argument(help="A bundled rig, or a rig file.")]


def add_commands(app: typer.Typer) -> None:
    """Adds all commands of this module to a command line."""
    tcp = "socket://127.0.0.1:7000"
    for name, function, example in (
        ("virtual-rig", virtual_rig, "dual-cell --tcp 127.0.0.1:7000 --speed 60"),
        ("record", record, f"dual-cell --link {tcp} --out session.db"),
        (
            "drive",
            drive_command,
            'dual-cell --link /dev/ttyACM0 --duty "0:0.5,500:0.78" --duration 1000',
        ),
        ("watch", watch, f"dual-cell --link {tcp}"),
        ("export", export, "session.db run.nc --start 10 --end 1000"),
    ):
        epilog = f"[dim]Example:[/]\n\n[bold]  jaxtwin {name} {example}[/]"
        app.command(name, rich_help_panel="A live rig", epilog=epilog)(function)


def record(
    rig: RigName,
    link: Links,
    out: Annotated[Path, typer.Option(help="The recording, session.db say.")],
    duration: Annotated[float, typer.Option(help="Seconds; 0 for ever.")] = 0.0,
    append: Annotated[bool, typer.Option(help="Go on with a recording that is there.")] = False,
    frames: Annotated[bool, typer.Option(help="Keep camera frames too.")] = False,
    publish: Annotated[str, typer.Option(help="mqtt://HOST/TOPIC: readings as JSON.")] = "",
    baud: Baud = 115_200,
    as_json: AsJson = False,
) -> None:
    """Records a live rig until Ctrl-C."""
    from ..rig import load_rig
    from ._bench import connect
    from ._recorder import Recorder

    loaded = load_rig(rig)
    with _stop_signals() as stop, contextlib.ExitStack() as stack:
        recorder = stack.enter_context(Recorder(out, loaded, append=append, keep_frames=frames))
        bench = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        publisher = None
        if publish:
            from ._mqtt import Publisher

            names = [channel.name for channel in loaded.channels]
            publisher = Publisher(publish, names, [cell.name for cell in loaded.cells])
            stack.callback(publisher.close)
        begin = shown = time.monotonic()
        while not stop.is_set() and not (duration and time.monotonic() - begin >= duration):
            records = bench.poll()
            if publisher is not None:
                publisher.publish(records)
            if time.monotonic() - shown >= 1.0 and not as_json:
                shown = time.monotonic()
                states = ", ".join(f"{name} {state}" for name, state in bench.states.items())
                _progress(f"{recorder.written} records, {states}")
    _print_report(out, as_json)


def export(
    recording: Annotated[Path, typer.Argument(help="What `record` wrote.")],
    out: Annotated[Path, typer.Argument(help="run.nc or run.csv")],
    step: Annotated[float, typer.Option(help="Of the time grid, s.")] = 1.0,
    start: Annotated[float | None, typer.Option(help="Leave out what was before, s.")] = None,
    end: Annotated[float | None, typer.Option(help="Leave out what came after, s.")] = None,
    as_json: AsJson = False,
) -> None:
    """Puts a recording on an even time grid, as .nc or .csv."""
    from ..io import write_recording
    from ._session import Session

    with Session(recording) as session:
        experiment = session.experiment(step=step, start=start, end=end)
    write_recording(experiment, out)
    gaps = experiment.gaps.tolist()
    if as_json:
        typer.echo(json.dumps({"samples": len(experiment.time), "gaps": gaps}))
    else:
        typer.echo(f"{out}: {len(experiment.time)} samples")


def drive_command(
    rig: RigName,
    link: Links,
    duty: Annotated[str, typer.Option(help='"0:0.5,500:0.78": from 500 s on 78 %.')],
    duration: Annotated[float, typer.Option(help="Seconds of the rig.")],
    out: Annotated[Path | None, typer.Option(help="Record at the same time.")] = None,
    silence: Annotated[float, typer.Option(help="Longest time without data, s.")] = 3.0,
    baud: Baud = 115_200,
) -> None:
    """Runs a duty schedule; the cells are off afterwards, whatever happens."""
    from ..rig import load_rig
    from ._bench import connect
    from ._drive import drive
    from ._recorder import Recorder

    loaded = load_rig(rig)
    with _stop_signals() as stop, contextlib.ExitStack() as stack:
        recorder = stack.enter_context(Recorder(out, loaded)) if out else None
        bench = stack.enter_context(connect(loaded, *link, journal=recorder, baud=baud))
        drive(
            bench,
            loaded,
            duty,
            duration=duration,
            silence=silence,
            stop=stop,
            progress=lambda t, pwm: _progress(f"{t:.0f} s of {duration:g} s, counts {pwm}"),
        )
    typer.echo("\nthe cells are off")


def virtual_rig(
    rig: RigName,
    tcp: Annotated[str, typer.Option(help="HOST:PORT to listen on.")] = "",
    pty: Annotated[bool, typer.Option("--pty", help="A pseudo-terminal.")] = False,
    mqtt: Annotated[str, typer.Option(help="mqtt://HOST:PORT/TOPIC to publish on.")] = "",
    speed: Annotated[float, typer.Option(help="Rig seconds in a second.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Of noise and faults.")] = 0,
    camera_hz: Annotated[float, typer.Option(help="Frames in a rig second.")] = 9.0,
    controller_hz: Annotated[float, typer.Option(help="Samples in a rig second.")] = 10.0,
    faults: Annotated[
        str,
        typer.Option(
            help="drop=0.01,corrupt=0.001,jumps=164,stall=30/5,disconnect=60,"
            "loosen=P1@300/10,fail=P2@600"
        ),
    ] = "",
    parameters: Annotated[str, typer.Option(help="A parameter set of the rig file.")] = "",
) -> None:
    """Simulates a rig behind the same protocol, until Ctrl-C."""
    from ..physics import Twin
    from ..rig import load_rig
    from ._faults import Faults
    from ._serve import PtyServer, Server, TcpServer, serve
    from ._time import SystemClock
    from ._virtual_rig import VirtualRig

    if [bool(tcp), pty, bool(mqtt)].count(True) != 1:
        raise JaxtwinError("virtual-rig: allowed is one of --tcp HOST:PORT, --pty, --mqtt URL")
    loaded = load_rig(rig)
    if parameters and parameters not in loaded.parameter_sets:
        raise JaxtwinError(
            f"--parameters {parameters}: {loaded.name} has {', '.join(loaded.parameter_sets)}"
        )
    server: Server
    if mqtt:
        from ._mqtt import MqttServer

        server = MqttServer(mqtt)
    else:
        server = TcpServer(tcp) if tcp else PtyServer()
    device = VirtualRig(
        Twin(loaded, loaded.parameter_sets[parameters] if parameters else None),
        speed=speed,
        seed=seed,
        camera_hz=camera_hz,
        controller_hz=controller_hz,
        faults=Faults.parse(faults),
    )
    typer.echo(f"{loaded.name} at {server.url}")
    with _stop_signals() as stop:
        try:
            serve(device, server, SystemClock(), stop)
        finally:
            server.close()


def watch(
    source: Annotated[str, typer.Argument(help="A rig (with --link), or a recording.")],
    link: Annotated[list[str] | None, typer.Option("--link", help="As for record.")] = None,
    speed: Annotated[float, typer.Option(help="Of a recording.")] = 1.0,
    duration: Annotated[float, typer.Option(help="Seconds; 0 until Ctrl-C.")] = 0.0,
    parameters: Annotated[str, typer.Option(help="A parameter set of the rig file.")] = "",
    baud: Baud = 115_200,
) -> None:
    """Shows a live rig or a recording, and the twin's prediction beside it."""
    from rich.live import Live

    from ..physics import Twin
    from ..rig import load_rig
    from ._bench import connect
    from ._replay import Replay
    from ._watch import Screen

    with _stop_signals() as stop, contextlib.ExitStack() as stack:
        if link:
            rig = load_rig(source)
            bench: Any = connect(rig, *link, baud=baud)
        else:
            bench = Replay(source, speed=speed)
            rig = bench.session.rig
        if parameters and parameters not in rig.parameter_sets:
            raise JaxtwinError(
                f"--parameters {parameters}: {rig.name} has {', '.join(rig.parameter_sets)}"
            )
        screen = Screen(Twin(rig, rig.parameter_sets[parameters] if parameters else None))
        stack.enter_context(bench)
        view = bench.view()
        live = stack.enter_context(Live(screen.render(), refresh_per_second=4))
        begin = shown = time.monotonic()
        while not stop.is_set() and not (duration and time.monotonic() - begin >= duration):
            bench.poll()
            # Drawing takes longer than reading: four times a second are enough for eyes.
            if time.monotonic() - shown >= 0.25:
                shown = time.monotonic()
                screen.update(view.take(), view.dropped)
                live.update(screen.render())
            if getattr(bench, "ended", False):
                break
        screen.update(view.take(), view.dropped)
        live.update(screen.render())


@contextlib.contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C and a polite kill set: nothing is interrupted in the middle."""
    stop = threading.Event()
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in signals}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _progress(text: str) -> None:
    typer.echo(f"\r\x1b[K{text}", nl=False, err=True)


def _print_report(file: Path, as_json: bool) -> None:
    from ._report import report
    from ._session import Session

    with Session(file) as session:
        content = report(session)
    if as_json:
        typer.echo(json.dumps(content))
        return
    typer.echo(f"\n{file}")
    for stream in content["streams"]:
        typer.echo(
            "  {stream} from {link}: {count}, every {period:.3g} s, longest step {longest:.3g} s, "
            "clock {drift:+.0f} ppm, late by {wait_99:.2g} s (99 %)".format(**stream)
        )
    for stream, count in content["lost"].items():
        typer.echo(f"  {stream}: {count} lost")
    for kind, count in content["events"].items():
        typer.echo(f"  {kind}: {count}")
