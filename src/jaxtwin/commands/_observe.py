"""`jaxtwin observe`: what a rig is doing, by an observer, and what is expected of it."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import BaudOption, ParameterFileOption, SetOption
from ._sources import open_twin
from ._watch import show, watched_rig


def observe(
    source: Annotated[
        str, typer.Argument(metavar="RIG|FILE", help="A rig, with --link; or a recording.")
    ],
    link: Annotated[
        list[str] | None, typer.Option("--link", metavar="URL", help="As for record.")
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Levels of the noise, as ProcessNoise.save writes them."),
    ] = None,
    sample_time: Annotated[
        float, typer.Option(min=0.01, metavar="S", help="The time between two readings.")
    ] = 1.0,
    speed: Annotated[
        float, typer.Option(min=0.001, help="Of a recording: so many of its seconds in one.")
    ] = 1.0,
    duration: Annotated[
        float | None, typer.Option(min=0, metavar="S", help="Until then, not until Ctrl-C.")
    ] = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Show what an observer says of a live rig or a recording: channels, what was expected of them
    and what is in a minute, temperatures that nothing measures, the room, and unexplained heat."""
    from ..live import Screen
    from ..observers import ProcessNoise, live_observer

    rig = watched_rig(source, link or [])
    twin = open_twin(rig, set_name, parameter_file)
    levels = None if noise is None else ProcessNoise.load(noise)
    screen = Screen(twin, live_observer(twin, levels, sample_time))
    show(screen, rig, source, link or [], speed, duration, baud)
