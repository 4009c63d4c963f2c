"""`jaxtwin serve`: a rig and its twin as a page in a browser."""

import contextlib
import getpass
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from ..errors import JaxtwinError
from ._alarm_command import AlarmCommand
from ._exit_codes import ALARMED
from ._options import (
    AnyAlarmOption,
    BaudOption,
    DurationOption,
    NoiseOption,
    ParameterFileOption,
    PublishOption,
    QuietOption,
    RigArgument,
    SetOption,
    WatchedLinkOption,
)
from ._output import check_output, say
from ._signals import stop_signals
from ._sources import draws_of, label_of, open_draws, open_store, open_twin
from ._unblocked_output import unblocked_output

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..live import Draws, Record, Recorder, RigConnection
    from ..observers import ProcessNoise
    from ..physics import Twin
    from ..rig import Rig
    from ..serve import TwinBeside
    from ..twin_store import TwinStore, TwinVersion


def serve(
    rig: RigArgument,
    link: WatchedLinkOption = None,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="A virtual rig in this process, without hardware.")
    ] = False,
    replay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A recording of the rig, .db.")
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0.1, max=1000, help="Seconds of a virtual rig or a recording in one."),
    ] = 1.0,
    faults: Annotated[
        str, typer.Option(metavar="WORDS", help="Of a virtual rig, as for virtual-rig.")
    ] = "",
    store: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A store of twins, .db, whose champion is followed."),
    ] = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    noise: NoiseOption = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="What is healthy, as 'monitor --save' wrote it."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Record, .db; one that is there is continued."),
    ] = None,
    publish: PublishOption = None,
    host: Annotated[str, typer.Option(help="The address on which it listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65_535, help="0 takes a free one.")] = 8000,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST",
            help="A further name in the address of the page, such as that of a reverse proxy; with "
            "its port, unless that is the usual one. May be repeated.",
        ),
    ] = None,
    allow_control: Annotated[
        bool, typer.Option("--allow-control", help="Clients with the token may command the rig.")
    ] = False,
    controller: Annotated[
        Path | None,
        typer.Option(
            "--controller",
            metavar="FILE",
            help="A controller file, .toml: who may command the rig may also set its references.",
        ),
    ] = None,
    self_optimise: Annotated[
        Literal["propose", "apply"] | None,
        typer.Option(
            "--self-optimise",
            help="After a refit of the champion, tune the controller and try it on the twin; what "
            "passes waits for somebody (propose), or takes over at rest (apply).",
        ),
    ] = None,
    mqtt_orders: Annotated[
        bool,
        typer.Option(
            "--mqtt-orders",
            help="Take orders to the store from the broker of --publish, such as to promote a "
            "version; who may publish there is the broker's to say.",
        ),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the token there, for its owner alone to read."),
    ] = None,
    silence: QuietOption = 10.0,
    alarm: AnyAlarmOption = None,
    duration: DurationOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Show a rig and its twin as a page in a browser, until Ctrl-C: what is measured and estimated,
    what is expected in a minute, what a monitor finds and why, and a log; also record it.

    The page only shows. With --allow-control, who has the token that is printed at the start may
    set a duty, or with --controller the temperatures to be held, behind all interlocks, and change
    the champion of the store. Who has the token may always stop the rig. The exit code is 5 if
    there was an alarm.
    """
    check_extra("serve")
    if [bool(link), virtual, replay is not None].count(True) != 1:
        raise typer.BadParameter("give one of --link, --virtual and --replay")
    if replay is not None and (out is not None or allow_control):
        raise typer.BadParameter("a replay is neither recorded nor commanded")
    if store is not None and (parameter_file is not None or set_name is not None):
        raise typer.BadParameter("give --store, or --parameters and --set")
    if controller is not None and not allow_control:
        raise typer.BadParameter("--controller needs --allow-control")
    if self_optimise is not None and (store is None or controller is None):
        raise typer.BadParameter("--self-optimise needs --store and --controller")
    if mqtt_orders and not (publish is not None and allow_control and store is not None):
        raise typer.BadParameter("--mqtt-orders needs --publish, --allow-control and --store")
    if faults and not virtual:
        raise typer.BadParameter("--faults are those of a rig with --virtual")
    check_output(out, ".db")
    check_output(token_file, option="--token-file")
    with stop_signals() as stop, unblocked_output(), contextlib.ExitStack() as stack:
        from ..serve import listening

        # Before all that takes time: a page that waits for its server then waits for an answer.
        opened = stack.enter_context(contextlib.closing(listening(host, port)))
        from ..live import (
            Finding,
            Guard,
            OperatingLimits,
            Publisher,
            Record,
            Recorder,
            Replay,
            opener,
            without_password,
        )
        from ..monitoring import MonitorCalibration
        from ..observers import ProcessNoise
        from ..physics import Faults, Twin
        from ..rig import load_rig
        from ..serve import (
            Access,
            Champion,
            PageServer,
            TwinBeside,
            VirtualLink,
            compile_loop,
        )

        loaded = load_rig(rig)
        address = f"{f'[{host}]' if ':' in host else host}:{opened.getsockname()[1]}"
        for url in link or ():  # what is invalid is refused before the twin is compiled
            opener(url, loaded, baud=baud)
        replayed = None
        if replay is not None:
            replayed = stack.enter_context(Replay(replay, speed=speed))
            replayed.check_rig(loaded)
        device = None
        if virtual:
            known = Faults.parse(faults)
            device = stack.enter_context(VirtualLink(Twin(loaded), speed=speed, faults=known))
        chosen, twins = _chosen_twin(loaded, store, parameter_file, set_name)
        holds = design = None
        if controller is not None:
            from ..control import read_controller, read_design  # which take half a second to import

            holds = read_controller(controller, loaded)
            design = read_design(controller, loaded)
        if self_optimise is not None and design is None:
            raise JaxtwinError(
                f"{controller}: design: expected references, duration and objective for which the "
                "controller is tuned, got none; docs/deploy.md has an example"
            )
        levels = None if noise is None else ProcessNoise.load(noise)
        healthy = None if calibration is None else MonitorCalibration.load(calibration)
        if allow_control:
            OperatingLimits.of(chosen.twin)  # refuses a rig without a limit

        def beside_of(twin: _ChosenTwin) -> TwinBeside:
            known = twin.noise if levels is None else levels
            draws = twin.draws() if allow_control else None
            return TwinBeside(twin.twin, twin.label, noise=known, calibration=healthy, draws=draws)

        def made() -> TwinBeside:
            beside = beside_of(chosen)
            if allow_control:
                Guard.of(beside.twin, draws=beside.draws)  # compiles
            if holds is not None:
                compile_loop(beside.twin, holds)
            return beside

        recorder = None
        if out is not None:
            recorder = stack.enter_context(Recorder(out, loaded, append=out.exists()))
        source: RigConnection | Replay
        early: list[Record] = []
        if replayed is not None:
            source, what = replayed, f"replay of {replayed.session.file.name}"
            beside = made()
        elif device is not None:
            beside, what = made(), "virtual rig"
            source = _connected(loaded, [device.url()], recorder, baud, stack)
        else:
            what = ", ".join(map(without_password, link or ()))
            source = _connected(loaded, link or [], recorder, baud, stack)
            beside, early = _polled_meanwhile(source, made)
        champion = None
        if twins is not None:
            champion = Champion(twins, lambda version: beside_of(_of_version(loaded, version)))
        command = stack.enter_context(AlarmCommand(alarm))

        def raised(finding: Finding) -> None:
            if finding.is_alarm:
                command.ring(finding)

        publisher = None
        if publish is not None:
            publisher = stack.enter_context(contextlib.closing(Publisher(publish, loaded)))

        access = Access.of(
            host, opened.getsockname()[1], names=tuple(name or ()), allow_control=allow_control
        )
        server = PageServer(
            source,
            beside,
            stop,
            access,
            opened,
            name=what,
            recording=out,
            silence=silence,
            champion=champion,
            controller=holds,
            policy=self_optimise,
            design=design,
            about={"operator": getpass.getuser()},
            raised=raised,
            publisher=publisher,
            takes_mqtt_orders=mqtt_orders,
        )
        with server:
            announce(address, access.token, token_file)
            if duration is not None:
                timer = threading.Timer(duration, stop.set)
                timer.daemon = True
                timer.start()
            server.loop.run(early)
    if command.rung:
        raise typer.Exit(ALARMED)


def check_extra(command: str) -> None:
    """Refuses to go on with a command without the web server.

    **Raises:** `JaxtwinError` that says how to install it.
    """
    if any(find_spec(name) is None for name in ("starlette", "uvicorn")):
        raise JaxtwinError(
            f"{command}: expected Starlette and uvicorn, which are not installed; pip install "
            "'jaxtwin[serve]', in a checkout pip install -e '.[serve]'"
        )


class _ChosenTwin(NamedTuple):
    """A twin, what it is for people, the noise that is stored with it, and what makes draws of its
    values."""

    twin: "Twin"
    label: str
    noise: "ProcessNoise | None"
    draws: "Callable[[], Draws | None]"


def _chosen_twin(
    rig: "Rig", store: Path | None, parameter_file: Path | None, set_name: str | None
) -> "tuple[_ChosenTwin, TwinStore | None]":
    """The twin that follows the rig, and the store whose champion it is, if there is one."""
    if store is not None:
        twins = open_store(store)
        return _of_version(rig, twins.version("champion")), twins
    twin = open_twin(rig, set_name, parameter_file)
    draws = partial(open_draws, rig, parameter_file)
    return _ChosenTwin(twin, label_of(parameter_file), None, draws), None


def _of_version(rig: "Rig", version: "TwinVersion") -> _ChosenTwin:
    twin = open_twin(rig, None, Path(version.address))
    return _ChosenTwin(
        twin,
        f"version {version.number} of {Path(version.store).name}",
        version.noise,
        lambda: draws_of(version.fit()),
    )


def _polled_meanwhile(
    source: "RigConnection", made: "Callable[[], TwinBeside]"
) -> "tuple[TwinBeside, list[Record]]":
    """Makes a twin, which compiles for seconds, while the source is polled: its journal has what
    arrives meanwhile. Returns these records too."""
    records: list[Record] = []
    with ThreadPoolExecutor(1, thread_name_prefix="first twin") as maker:
        ready = maker.submit(made)
        while not ready.done():
            records += source.poll()
        return ready.result(), records


def _connected(
    rig: "Rig",
    links: list[str],
    recorder: "Recorder | None",
    baud: int,
    stack: contextlib.ExitStack,
) -> "RigConnection":
    from ..live import connect

    return stack.enter_context(connect(rig, *links, journal=recorder, baud=baud))


def announce(address: str, token: str, file: Path | None) -> None:
    """Says where the page is. The token stands behind a #, which browsers do not send."""
    if file is None:
        say(f"http://{address}/\nto command, or to stop the rig: http://{address}/#{token}")
        return
    with contextlib.suppress(FileNotFoundError):
        file.unlink()
    # Made with these rights, so that nobody else can read it for a moment.
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(f"{token}\n")
    say(f"http://{address}/\nthe token is in {file}")
