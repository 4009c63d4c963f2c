"""`jaxtwin observe`: what a rig is doing, by an observer, and what is expected of it."""

from typing import TYPE_CHECKING, Annotated

import typer

from ._options import (
    BaudOption,
    DurationOption,
    NoiseOption,
    ParameterFileOption,
    ReplaySpeedOption,
    SetOption,
    WatchedArgument,
    WatchedLinkOption,
)
from ._sources import open_twin
from ._watch import show

if TYPE_CHECKING:
    from ..rig import Rig


def observe(
    source: WatchedArgument,
    link: WatchedLinkOption = None,
    noise: NoiseOption = None,
    sample_time: Annotated[
        float, typer.Option(min=0.01, metavar="S", help="The time between two readings.")
    ] = 1.0,
    speed: ReplaySpeedOption = 1.0,
    duration: DurationOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    baud: BaudOption = 115_200,
) -> None:
    """Show what an observer says of a live rig or a recording: channels, what was expected of them
    and what is in a minute, temperatures that nothing measures, the room, and unexplained heat."""
    from ..live import Screen
    from ..observers import ProcessNoise, live_observer

    def screen_of(rig: "Rig") -> Screen:
        twin = open_twin(rig, set_name, parameter_file)
        levels = None if noise is None else ProcessNoise.load(noise)
        return Screen(twin, live_observer(twin, levels, sample_time))

    show(source, link or [], screen_of, speed, duration, baud)
