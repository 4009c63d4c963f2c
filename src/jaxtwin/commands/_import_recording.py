"""`jaxtwin import`: the file of a logger as a recording of a rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import JsonOption, OverwriteOption
from ._output import aligned, check_json, check_new_output, say, write_json

if TYPE_CHECKING:
    from ..io import Experiment
    from ..rig import Rig


def import_recording(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Of a logger: .csv, .xlsx or .parquet.")
    ],
    rig: Annotated[str, typer.Option(metavar="RIG", help="The rig file whose recording it is.")],
    out: Annotated[Path, typer.Option(metavar="OUT", help="Where to: .csv or .nc.")],
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TITLE=NAME",
            help="What a column is: t2=T1, heater_on=duty_P1, room=ambient, clock=time; "
            "time_t2=T1_time is the time at which T1 was read.",
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TITLE",
            help="Leave a column out; * and ? stand for any characters, '*' alone for all that "
            "would be refused.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = None,
) -> None:
    """Read the file of a logger once, check it against the rig, and write it as a recording.

    A column that is called as a channel of the rig, in large or small letters, needs no --column.
    """
    from ..io import column_names, read_recording, write_recording
    from ..io._delimited import names_of_titles
    from ..rig import load_rig

    check_new_output(out, overwrite, ".csv", ".nc")
    check_json(json)
    of_rig = load_rig(rig)
    titles = [*column_names(file)]
    names = _channels_by_title(of_rig, titles) | _named(column or ())
    experiment = read_recording(file, rig=of_rig, columns=names, ignore=ignore or ())
    _check_rig(experiment, of_rig, file)
    read_as = zip(titles, names_of_titles(titles, names, ignore or ()), strict=True)
    left_out = [title for title, name in read_as if name is None]
    write_recording(experiment, out)
    missing = [c.name for c in of_rig.channels if c.name not in experiment.channels]
    unstated = [one.name for one in of_rig.inputs if one.name not in experiment.inputs]
    gaps = experiment.gaps.tolist()
    say(f"{out}: {len(experiment.time)} samples in {experiment.duration:g} s, from {file}", json)
    say(aligned(_ranges(experiment, names)), json)
    if left_out:
        say(f"  left out: {', '.join(left_out)}", json)
    if missing:
        say(f"  channels of {of_rig.name} without a column: {', '.join(missing)}", json)
    if unstated:
        say(f"  inputs of {of_rig.name} without a column: {', '.join(unstated)}", json)
    for before, after in gaps:
        say(f"  nothing from {before:g} s to {after:g} s", json)
    write_json(
        json,
        {
            "samples": len(experiment.time),
            "duration_s": experiment.duration,
            "columns": names,
            "left_out": left_out,
            "channels": list(experiment.channels),
            "channels_without_column": missing,
            "inputs_without_column": unstated,
            "gaps_s": gaps,
        },
    )


def _named(columns: Sequence[str]) -> dict[str, str]:
    pairs = [text.rpartition("=") for text in columns]
    for (title, _, name), text in zip(pairs, columns, strict=True):
        if not title or not name:
            raise typer.BadParameter(f"--column: expected TITLE=NAME, got {text!r}")
    return {title: name for title, _, name in pairs}


def _channels_by_title(rig: "Rig", titles: Sequence[str]) -> dict[str, str]:
    """The columns that are called as a channel, title -> channel."""
    channels = {channel.name.lower(): channel.name for channel in rig.channels}
    found = {title: channels[title.lower()] for title in titles if title.lower() in channels}
    # Of two columns that differ only in their letters, neither is the channel without a word.
    return {t: c for t, c in found.items() if list(found.values()).count(c) == 1}


def _check_rig(experiment: "Experiment", rig: "Rig", file: Path) -> None:
    """Refuses a recording whose channels, cells or inputs are not those of the rig."""
    from .._errors import RecordingError
    from .._name_suggestions import did_you_mean
    from ..io._duty_of_rig import check_duty_of_rig

    channels = [channel.name for channel in rig.channels]
    unknown = [name for name in experiment.channels if name not in channels]
    if unknown:
        raise RecordingError(
            f"{file}: expected the channels {', '.join(channels)} of {rig.name}, got "
            f"{', '.join(unknown)}{did_you_mean(unknown, channels)}; --column names a column, "
            "--ignore leaves it out"
        )
    check_duty_of_rig(experiment, rig, str(file), RecordingError)


def _ranges(experiment: "Experiment", names: dict[str, str]) -> list[tuple[str, ...]]:
    """A row for each column that was read: its name, its title, and what it holds."""
    import numpy as np

    titles = {name.partition("_degC")[0]: title for title, name in names.items()}
    values = {
        f"duty_P{cell + 1}": (column, "")
        for cell, column in enumerate(np.asarray(experiment.duty).T)
    }
    if experiment.temperatures is not None:
        recorded = np.asarray(experiment.temperatures).T
        values |= {c: (v, " degC") for c, v in zip(experiment.channels, recorded, strict=True)}
    if experiment.ambient is not None:
        values["ambient"] = np.atleast_1d(experiment.ambient), " degC"
    rows = []
    states = {}
    for name, column in experiment.inputs.items():
        if column.dtype.kind == "U":
            states[f"input_{name}"] = ", ".join(dict.fromkeys(column.tolist()))
        else:
            values[f"input_{name}"] = column, ""
    for name, (column, unit) in values.items():
        source = f"from {titles[name]}" if titles.get(name, name) != name else ""
        lost = int(np.isnan(column).sum())
        low, high = (
            (np.nanmin(column), np.nanmax(column)) if lost < column.size else (np.nan, np.nan)
        )
        note = f", {lost} missing" if lost else ""
        rows.append((f"  {name}", source, f"{low:.4g} to {high:.4g}{unit}{note}"))
    rows += [
        (f"  {name}", f"from {titles[name]}" * (titles.get(name, name) != name), text)
        for name, text in states.items()
    ]
    return rows
