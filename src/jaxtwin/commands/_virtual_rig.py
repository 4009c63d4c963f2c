"""`jaxtwin virtual-rig`: a twin behind the protocol of a real rig."""

from typing import TYPE_CHECKING, Annotated

import typer

from ._options import ParameterFileOption, RigArgument, SeedOption, SetOption
from ._output import say
from ._signals import stop_signals
from ._sources import open_twin

if TYPE_CHECKING:
    from ..live import Server

PORT = 7000


def virtual_rig(
    rig: RigArgument,
    host: Annotated[str, typer.Option(help="The address on which it listens.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65_535, help=f"{PORT} if nothing is said; 0 takes a free one."),
    ] = None,
    # The name of these two before they were those of `serve`.
    tcp: Annotated[str | None, typer.Option(metavar="HOST:PORT", hidden=True)] = None,
    pty: Annotated[bool, typer.Option("--pty", help="As a serial port: a terminal.")] = False,
    mqtt: Annotated[
        str | None, typer.Option(metavar="URL", help="mqtt://HOST:PORT/TOPIC, through a broker.")
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.1, max=1e3, help="Seconds of the rig in a second.")
    ] = 1.0,
    camera_rate: Annotated[
        float, typer.Option(min=0.01, max=1000, help="Frames in a second of the rig.")
    ] = 9.0,
    controller_rate: Annotated[
        float, typer.Option(min=0.01, max=1000, help="Controller lines in a second of the rig.")
    ] = 10.0,
    faults: Annotated[
        str,
        typer.Option(
            metavar="WORDS",
            help="What goes wrong: some of drop=0.01, corrupt=0.001, jumps=164, stall=30/5, "
            "disconnect=60, loosen=P1@300/10, fail=P2@600, block=P1@300/3; docs/live.md has all.",
        ),
    ] = "",
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    seed: SeedOption = 0,
) -> None:
    """Simulate a rig behind the protocol of a real one, with noise and faults, until Ctrl-C."""
    from ..live import SystemClock, VirtualRig, serve
    from ..physics import Faults
    from ..rig import load_rig

    if [tcp is not None, port is not None, pty, mqtt is not None].count(True) > 1:
        raise typer.BadParameter("give one of --port, --pty and --mqtt")
    with stop_signals() as stop:
        device = VirtualRig(
            open_twin(load_rig(rig), set_name, parameter_file),
            speed=speed,
            seed=seed,
            camera_rate=camera_rate,
            controller_rate=controller_rate,
            faults=Faults.parse(faults),
        )
        # The port is opened only when the rig can answer: a port that accepts connections and is
        # silent is worse than none.
        address = tcp or f"{host}:{PORT if port is None else port}"
        server = _server(address, pty, mqtt)
        try:
            say(f"{rig} at {server.url}; look at it: jaxtwin watch {rig} --link {server.url}")
            serve(device, server, SystemClock(), stop)
        finally:
            server.close()


def _server(address: str, pty: bool, mqtt: str | None) -> "Server":
    from ..live import MqttServer, PtyServer, TcpServer

    if mqtt is not None:
        return MqttServer(mqtt)
    return PtyServer() if pty else TcpServer(address)
