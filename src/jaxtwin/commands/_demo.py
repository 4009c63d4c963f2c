"""`jaxtwin demo`: the paper's rig simulated, matched and analysed, as a report; or a live story."""

import contextlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._show_progress import show_progress
from ._signals import stop_signals

if TYPE_CHECKING:
    from ..live import StopRequest


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The report's folder.")] = Path(
        "report"
    ),
    recordings: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the authors' recordings lie; else looked for."),
    ] = None,
    draws: Annotated[
        int, typer.Option(min=50, help="Of the larger sensitivity analysis.")
    ] = 10_000,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="In place of the report: a page with a virtual rig whose contact comes loose.",
        ),
    ] = False,
    speed: Annotated[
        float, typer.Option(min=0.5, max=20, help="With --live: seconds of the rig in one.")
    ] = 10.0,
    port: Annotated[
        int, typer.Option(min=0, max=65_535, help="With --live: of the page; 0 takes a free one.")
    ] = 8000,
) -> None:
    """Simulate, match and analyse the paper's rig; write a report with pictures and numbers.

    With --live, a browser shows a virtual rig until Ctrl-C: a controller that holds a plate even, a
    contact that comes loose, what the monitor finds, the diagnosis, a refit, the promotion of the
    new twin, and a controller that is tuned on it, until the plate is even again.
    """
    if live:
        with stop_signals() as stop, contextlib.ExitStack() as stack:
            _serve_story(stop, stack, speed, port)
        return
    from ..report import write_demo

    with show_progress() as progress:
        page = write_demo(out, recordings=recordings, draws=draws, progress=progress)
    print(page)


def _serve_story(stop: "StopRequest", stack: contextlib.ExitStack, speed: float, port: int) -> None:
    from ..live import Guard, connect
    from ..physics import Twin
    from ..serve import (
        Access,
        Champion,
        DemoScript,
        PageServer,
        TwinBeside,
        VirtualLink,
        compile_loop,
        demo_controller,
        demo_faults,
        demo_rig,
        demo_store,
        listening,
    )
    from ..twin_store import TwinVersion
    from ._serve import announce, check_extra
    from ._sources import draws_of, open_twin

    check_extra("demo")
    opened = stack.enter_context(contextlib.closing(listening("127.0.0.1", port)))
    at_port = opened.getsockname()[1]
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    rig = demo_rig()
    twin = Twin(rig)
    device = stack.enter_context(VirtualLink(twin, speed=speed, faults=demo_faults()))

    def made(version: TwinVersion) -> TwinBeside:
        twin = open_twin(rig, None, Path(version.address))
        draws = draws_of(version.fit())
        return TwinBeside(twin, f"version {version.number}", noise=version.noise, draws=draws)

    with show_progress() as progress:
        progress.step("matching a first twin to four simulated sessions")
        store = demo_store(rig, folder, speed)
        progress.step("starting the observer")
        champion = Champion(store, made)
        beside = made(store.version("champion"))
        Guard.of(beside.twin, draws=beside.draws)  # compiles
        controller, design = demo_controller()
        compile_loop(beside.twin, controller)
        source = stack.enter_context(connect(rig, device.url()))
    access = Access.of("127.0.0.1", at_port, allow_control=True)
    server = PageServer(
        source,
        beside,
        stop,
        access,
        opened,
        name="virtual rig of the demo",
        champion=champion,
        controller=controller,
        design=design,
        policy="apply",
        consumers=lambda page, desk: [DemoScript(desk, page)],
    )
    with server:
        announce(f"127.0.0.1:{at_port}", access.token, None)
        server.loop.run()
