"""Arguments and options that several commands have."""

from pathlib import Path
from typing import Annotated, Literal

import typer

RigArgument = Annotated[
    str, typer.Argument(metavar="RIG", help="A bundled rig ('jaxtwin rigs') or a rig file.")
]
RecordingsArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING",
        help="Files (.mat, .csv, .nc, .db), or names of known recordings ('jaxtwin data list').",
    ),
]
ParameterFileOption = Annotated[
    Path | None,
    typer.Option(
        "--parameters", metavar="FILE", help="Values from a parameter file, such as a saved fit."
    ),
]
SetOption = Annotated[
    str | None,
    typer.Option(
        "--set", metavar="NAME", help="Values from a parameter set of the rig, e.g. published."
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="The numbers as JSON; - is standard output."),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")]
SeedOption = Annotated[int, typer.Option(min=0, help="The same seed gives the same numbers.")]
GapsOption = Annotated[
    Literal["hold", "split"],
    typer.Option(
        help="Over a gap in the times the duty is held, or the parts between gaps are recordings "
        "of their own."
    ),
]
NoiseOption = Annotated[
    Path | None,
    typer.Option(
        "--noise",
        metavar="FILE",
        help="Levels of the noise for an observer, as ProcessNoise.save writes them.",
    ),
]
WatchedArgument = Annotated[
    str, typer.Argument(metavar="RIG|FILE", help="A rig, with --link; or a recording.")
]
WatchedLinkOption = Annotated[
    list[str] | None, typer.Option("--link", metavar="URL", help="As for record.")
]
ReplaySpeedOption = Annotated[
    float, typer.Option(min=0.001, help="The seconds of a recording that are replayed in one.")
]
DurationOption = Annotated[
    float | None, typer.Option(min=0, metavar="S", help="Until then, not until Ctrl-C.")
]
LinkOption = Annotated[
    list[str],
    typer.Option(
        "--link",
        metavar="URL",
        help="socket://HOST:PORT, a serial port, rfc2217://HOST:PORT, tclab://PORT or "
        "mqtt://HOST/TOPIC; may be repeated, for a controller and a camera, say.",
    ),
]
PublishOption = Annotated[
    str | None,
    typer.Option(
        metavar="URL", help="mqtt://HOST/TOPIC: readings, events, estimates and findings as JSON."
    ),
]
BaudOption = Annotated[int, typer.Option(min=1, metavar="RATE", help="Of serial ports.")]
DatabaseOption = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="Record at the same time, .db.")
]
SilenceOption = Annotated[
    float,
    typer.Option(min=0.1, metavar="S", help="Stop after so long without data, at most 5."),
]
QuietOption = Annotated[
    float, typer.Option(min=0.1, metavar="S", help="Alarm after so long without data.")
]
AmbientOption = Annotated[
    float | None,
    typer.Option(
        metavar="DEGC",
        help="The temperature of the room, for a rig that does not measure it. Needed if the rig "
        "starts more than 10 K from the temperature of the rig file.",
    ),
]
ResetOption = Annotated[
    bool, typer.Option("--reset", help="End a trip of the device first. Look why it tripped.")
]
AcceptOption = Annotated[
    bool,
    typer.Option(
        "--accept",
        help="Begin although the twin says that the rig would exceed its limit. The interlocks act "
        "all the same.",
    ),
]
AlarmOption = Annotated[
    str | None,
    typer.Option(
        metavar="COMMAND",
        help="Run at an alarm, when an interlock stops the run, and if the rig may heat after a "
        "stop; JAXTWIN_ALARM says which.",
    ),
]
AnyAlarmOption = Annotated[
    str | None,
    typer.Option(metavar="COMMAND", help="Run at an alarm; JAXTWIN_ALARM says which."),
]
OperatorOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Kept in the recording; the user's name.")
]
