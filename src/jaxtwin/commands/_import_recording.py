"""`jaxtwin import`: the file of a logger as a recording of a rig."""

import hashlib
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import typer

from .._display import aligned
from ._options import JsonOption, OverwriteOption
from ._output import check_json, check_new_output, say, write_json

if TYPE_CHECKING:
    from ..io import Experiment
    from ..rig import Rig


@final
@dataclass(frozen=True)
class ReadingOptions:
    """How a file is read: arguments of `read_recording`, which options of the command give."""

    columns: dict[str, str] = field(default_factory=dict)
    ignore: tuple[str, ...] = ()
    scale: dict[str, str] = field(default_factory=dict)
    duty: float | None = None
    header: int | None = None
    sheet: str | None = None
    spread: bool = False

    def words(self) -> list[str]:
        """The options of a command line."""
        words = [w for t, n in self.columns.items() for w in ("--column", f"{t}={n}")]
        words += [w for n, s in self.scale.items() for w in ("--scale", f"{n}={s}")]
        words += [w for title in self.ignore for w in ("--ignore", title)]
        words += [] if self.duty is None else ["--duty", f"{self.duty:g}"]
        if self.header is not None:
            words += ["--header-line", str(self.header)] if self.header else ["--no-header"]
        words += [] if self.sheet is None else ["--sheet", self.sheet]
        return words + ["--spread"] * self.spread

    def arguments(self) -> dict[str, Any]:
        """The arguments of `read_recording`."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def import_recording(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Of a logger: text, .xlsx, .parquet, .mat, .tdms or .lvm."
        ),
    ],
    rig: Annotated[
        str | None, typer.Option(metavar="RIG", help="The rig file whose recording it is.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="OUT", help="Where to: .csv or .nc.")] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TITLE=NAME",
            help="What a column is, by its title or its number: t2=T1, heater_on=duty_P1, "
            "room=ambient, clock=time, 4=T2; time_t2=T1_time is the time at which T1 was read.",
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
    scale: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FACTOR",
            help="What the numbers of a column mean: 'duty_P1=1/2220 W', 'T1=0.1'.",
        ),
    ] = None,
    duty: Annotated[
        float | None,
        typer.Option(metavar="DUTY", help="The constant duty of cells without a column."),
    ] = None,
    no_header: Annotated[
        bool, typer.Option("--no-header", help="No titles: --column 1=time_s names by number.")
    ] = False,
    header_line: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="The line of the titles, where they are not found."),
    ] = None,
    sheet: Annotated[
        str | None, typer.Option(metavar="NAME", help="Of a workbook; otherwise the first.")
    ] = None,
    spread: Annotated[
        bool,
        typer.Option("--spread", help="Spread samples of one time evenly: a clock of seconds."),
    ] = False,
    mask_glitches: Annotated[
        bool,
        typer.Option(
            "--mask-glitches",
            help="Leave out single readings that are far from those before and after them.",
        ),
    ] = False,
    overwrite: OverwriteOption = False,
    json: JsonOption = None,
) -> None:
    """Read the file of a logger once, check it against the rig, and write it as a recording.

    Without --out it shows what the file holds, and the command that would read it. A column that is
    called as a channel of the rig, in large or small letters, needs no --column.
    """
    from ..rig import load_rig

    if no_header and header_line is not None:
        raise typer.BadParameter("--no-header, --header-line: expected one of them, got both")
    reading = ReadingOptions(
        columns=_pairs(column, "--column", "TITLE=NAME"),
        ignore=tuple(ignore or ()),
        scale=_pairs(scale, "--scale", "NAME=FACTOR", first=True),
        duty=duty,
        header=0 if no_header else header_line,
        sheet=sheet,
        spread=spread,
    )
    of_rig = None if rig is None else load_rig(rig)
    if out is None:
        from ._file_overview import overview

        say(overview(file, of_rig, rig, reading))
        return
    if rig is None or of_rig is None:
        raise typer.BadParameter("--rig: expected the rig file whose recording it is, beside --out")
    check_new_output(out, overwrite, ".csv", ".nc")
    check_json(json)
    _import(file, of_rig, rig, reading, mask_glitches, out, json)


def _import(
    file: Path,
    rig: "Rig",
    rig_name: str,
    reading: ReadingOptions,
    mask_glitches: bool,
    out: Path,
    json: Path | None,
) -> None:
    """Reads a file as the options say, and writes the recording with what was done."""
    from ..io import column_names, read_recording, write_recording

    words = reading.words()
    columns = _channels_by_title(file, rig, reading) | reading.columns
    reading = replace(reading, columns=columns)
    experiment = read_recording(file, rig=rig, **reading.arguments())
    if mask_glitches:
        experiment, words = experiment.without_glitches(), [*words, "--mask-glitches"]
    _check_rig(experiment, rig, file)
    of_columns = {"columns", "ignore", "scale", "header", "sheet"}
    arguments = {k: v for k, v in reading.arguments().items() if k in of_columns}
    read_as = column_names(file, rig=rig, **arguments)
    left_out = [title for title, name in read_as.items() if name is None]
    missing = [c.name for c in rig.channels if c.name not in experiment.channels]
    unstated = [
        rig_input.name for rig_input in rig.inputs if rig_input.name not in experiment.inputs
    ]
    gaps = experiment.gaps.tolist()
    lines = [aligned(_ranges(experiment, read_as))]
    lines += [f"  left out: {', '.join(left_out)}"] * bool(left_out)
    lines += [f"  channels of {rig.name} without a column: {', '.join(missing)}"] * bool(missing)
    lines += [f"  inputs of {rig.name} without a column: {', '.join(unstated)}"] * bool(unstated)
    lines += [f"  nothing from {before:g} s to {after:g} s" for before, after in gaps]
    lines += [f"  {note}" for note in experiment.notes]
    lines += [f"  {glitch}; --mask-glitches leaves it out" for glitch in experiment.glitches]
    command = ["jaxtwin", "import", file.name, "--rig", Path(rig_name).name, *words]
    checksum = hashlib.sha256(file.read_bytes()).hexdigest()
    history = [f"{shlex.join(command)} --out {out.name}", f"of {file.name}, SHA-256 {checksum}"]
    write_recording(experiment, out, history=[*history, *"\n".join(lines).splitlines()])
    say(f"{out}: {len(experiment.time)} samples in {experiment.duration:g} s, from {file}", json)
    for text in lines:
        say(text, json)
    write_json(
        json,
        {
            "samples": len(experiment.time),
            "duration_s": experiment.duration,
            "columns": columns,
            "left_out": left_out,
            "channels": list(experiment.channels),
            "channels_without_column": missing,
            "inputs_without_column": unstated,
            "gaps_s": gaps,
            "notes": list(experiment.notes),
        },
    )


def _pairs(
    texts: Sequence[str] | None, option: str, form: str, first: bool = False
) -> dict[str, str]:
    """The pairs of an option that may be repeated, divided at the first or the last =."""
    parts = [text.partition("=") if first else text.rpartition("=") for text in texts or ()]
    for (left, _, right), text in zip(parts, texts or (), strict=True):
        if not left or not right:
            raise typer.BadParameter(f"{option}: expected {form}, got {text!r}")
    return {left: right for left, _, right in parts}


def _channels_by_title(file: Path, rig: "Rig", reading: ReadingOptions) -> dict[str, str]:
    """The columns that are called as a channel, title -> channel."""
    from ..errors import RecordingError
    from ..io import Choices, table_content, text_table, unit_of_title

    try:
        content = table_content(file, reading.sheet)
        titles = text_table(content, Choices(reading.columns), reading.header).titles
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None
    channels = {channel.name.lower(): channel.name for channel in rig.channels}
    named = {}
    for title in titles:
        stem = title if title.lower() in channels else unit_of_title(title).stem
        if stem.lower() in channels and title not in reading.columns:
            named[title] = channels[stem.lower()]
    taken = [*named.values(), *reading.columns.values()]
    # Of two columns that differ only in their letters, neither is the channel without a word.
    return {t: c for t, c in named.items() if taken.count(c) == 1 and titles.count(t) == 1}


def _check_rig(experiment: "Experiment", rig: "Rig", file: Path) -> None:
    """Refuses a recording whose channels, cells or inputs are not those of the rig."""
    from .._name_suggestions import did_you_mean
    from ..errors import RecordingError
    from ..io import check_duty_of_rig

    channels = [channel.name for channel in rig.channels]
    unknown = [name for name in experiment.channels if name not in channels]
    if unknown:
        raise RecordingError(
            f"{file}: expected the channels {', '.join(channels)} of {rig.name}, got "
            f"{', '.join(unknown)}{did_you_mean(unknown, channels)}; --column names a column, "
            "--ignore leaves it out"
        )
    check_duty_of_rig(experiment, rig, str(file), RecordingError)


def _ranges(experiment: "Experiment", read_as: Mapping[str, str | None]) -> list[tuple[str, ...]]:
    """A row for each column that was read: its name, its title with its unit, and what it holds."""
    import numpy as np

    sources = {}
    for title, text in read_as.items():
        name, _, unit = (text or "").partition("_deg")
        if text is not None and title != text:
            for ending in ("_K", "_mK", "_%"):
                name = name.removesuffix(ending)
            unit = text.removeprefix(name).strip("_")
            is_new = unit not in ("", "degC") and unit not in title
            sources[name] = f"from {title}" + f", {unit}" * is_new
    values = {
        f"duty_{name}": (column, "")
        for name, column in zip(experiment.cell_names, np.asarray(experiment.duty).T, strict=True)
    }
    if experiment.temperatures is not None:
        recorded = np.asarray(experiment.temperatures).T
        values |= {c: (v, " degC") for c, v in zip(experiment.channels, recorded, strict=True)}
    if experiment.ambient is not None:
        values["ambient"] = np.atleast_1d(experiment.ambient), " degC"
    rows = []
    for name, column in experiment.inputs.items():
        if column.dtype.kind == "U":
            states = ", ".join(dict.fromkeys(column.tolist()))
            rows.append((f"  input_{name}", sources.get(f"input_{name}", ""), states))
        else:
            values[f"input_{name}"] = column, ""
    of_numbers = []
    for name, (column, unit) in values.items():
        lost = int(np.isnan(column).sum())
        low, high = (
            (np.nanmin(column), np.nanmax(column)) if lost < column.size else (np.nan, np.nan)
        )
        note = f", {lost} missing" if lost else ""
        source = sources.get(name) or sources.get(name.replace("duty", "pwm"), "")
        of_numbers.append((f"  {name}", source, f"{low:.4g} to {high:.4g}{unit}{note}"))
    return [*of_numbers, *rows]
