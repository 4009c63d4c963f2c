"""What a logger's file may hold: `jaxtwin import FILE` without further words.

The roles of columns are guessed from titles, units and values. A guess is shown, with the command
that states it, and never used to write a recording.
"""

import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._display import aligned

if TYPE_CHECKING:
    from ..io import Experiment, TextTable
    from ..rig import Rig
    from ._import_recording import ReadingOptions

TIME_WORDS = r"time|elapsed|x_value|zeit|clock|date|second|stamp|created"
DUTY_WORDS = (
    r"heat|heiz|duty|pwm|relay|ssr|power|output|switch|drive|control|volt|current|cool|peltier"
    r"|(^|[\W_])(out|u)$"
)
ROOM_WORDS = r"room|amb|outside|outdoor|indoor|raum|umgebung|environ|luft|air"
TEMPERATURE_WORDS = r"temp|(^|[\W_])t\d*$|therm|(^|[\W_])tc\d*|sensor|probe|ntc|pt\d+|bed|tank|oven"
# Words in titles by which a role is guessed.
REFERENCE_WORDS = r"set[ _-]?p|target|soll|reference|ziel|limit|max|min"

# Titles that say nothing, whose columns are guessed by their values.
NO_WORDS = r"(field|ch|channel|value|col|column|data|ai|var|y)?[ _]?\d*"

# The number of rows that are shown.
SHOWN_ROWS = 3


def overview(file: Path, rig: "Rig | None", rig_name: str | None, given: "ReadingOptions") -> str:
    """What a file holds and the command that would read it, in lines for a person.

    **Raises:** `RecordingError` if it holds no table.
    """
    from ..errors import RecordingError
    from ..io import Choices, is_data, read_recording, table_content, text_table

    try:
        content = table_content(file, given.sheet)
        table = text_table(content, Choices(given.columns), given.header)
        if given.header is None and is_data(table.titles):
            given = replace(given, header=0)
            table = text_table(content, Choices(given.columns), 0)
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from None
    roles, reading = _guess(table, rig, given)
    lines = [
        f"{file}: {len(table.rows)} rows of {len(table.titles)} columns{_form(file, table)}",
        "",
    ]
    lines += [aligned(_rows(table, roles)), ""]
    command = [
        *("jaxtwin", "import", str(file), "--rig", rig_name or "RIG.toml"),
        *reading.words(),
        *("--out", "RECORDING.csv"),
    ]
    try:
        experiment = read_recording(file, rig=rig, **reading.arguments())
    except RecordingError as error:
        if not reading.spread and "--spread" in str(error):
            return overview(file, rig, rig_name, replace(given, spread=True))
        lines += [f"The guess is not read: {error}"]
    else:
        lines += _sampling(experiment)
    lines += ["", "The command that would read it so; nothing is written before you give it:", ""]
    return "\n".join([*lines, f"  {shlex.join(command)}"])


def _form(file: Path, table: "TextTable") -> str:
    """How a file of text is divided, for the first line."""
    if file.suffix.lower() in (".xlsx", ".parquet", ".mat", ".tdms"):
        return ""
    names = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}
    where = f"titles in line {table.titles_at}" if table.titles_at else "no titles"
    return f", separated by {names[table.separator]}, {where}"


def _guess(
    table: "TextTable", rig: "Rig | None", given: "ReadingOptions"
) -> "tuple[list[str], ReadingOptions]":
    """The role of each column in words, and the arguments that read the file so."""
    columns, scale, roles = dict(given.columns), dict(given.scale), []
    names = _Names(rig, [*columns.values()])
    kinds = [_Numbers(table, place) for place in range(len(table.titles))]
    known = [
        _known(table, place, rig, given) if numbers.are_read else None
        for place, numbers in enumerate(kinds)
    ]
    has_time = any(text is not None and text.startswith("time") for text in known)
    for text in filter(None, known):
        names.take(text)
    for place, title in enumerate(table.titles):
        numbers, key = kinds[place], title or str(place + 1)
        if table.titles.count(title) > 1:
            key = str(place + 1)
        if known[place] is not None:
            roles.append(f"{known[place]}" + " (named)" * (key in given.columns))
            continue
        guessed = _role(table, place, numbers, has_time)
        if guessed == "time":
            has_time = True
            columns[key] = "time" if numbers.in_words else f"time_{numbers.unit or 's'}"
        elif guessed == "duty":
            name = names.next_drive()
            columns[key] = name
            if numbers.unit not in ("", "%", "1") or numbers.largest > 100:
                scale[name] = f"1/{numbers.largest:g} {numbers.unit or 'counts'}"
            elif numbers.unit == "" and numbers.largest > 1:
                columns[key] = f"{name}_%"
        elif guessed == "ambient" and "ambient" not in names.taken:
            columns[key] = "ambient"
            names.take("ambient")
        elif guessed in ("temperature", "ambient"):
            columns[key] = names.next_channel()
        else:
            roles.append("left out (guess)")
            continue
        scaled = f", full duty {scale[columns[key]][2:]}" if columns[key] in scale else ""
        roles.append(f"{columns[key]} (guess{scaled})")
    left_out = any(role.startswith("left out") for role in roles)
    ignore = given.ignore or (("*",) if left_out else ())
    has_duty = any(name.startswith(("duty", "pwm")) for name in names.taken)
    duty = given.duty if has_duty or given.duty is not None else 0.0
    reading = replace(given, columns=columns, scale=scale, ignore=ignore, duty=duty)
    return roles, reading


class _Numbers:
    """What the fields of a column show."""

    def __init__(self, table: "TextTable", place: int):
        from ..io import TRUTH, in_english, is_missing, is_time, is_timestamp_title, unit_of_title

        fields = [row[place] for _, row in table.rows if len(row) > place]
        filled = [text for text in fields if not is_missing(text)]
        numbers = [_number(text) for text in filled]
        self.values = np.array([x for x in numbers if x is not None])
        self.is_numeric = bool(filled) and len(self.values) == len(filled)
        self.is_truth = bool(filled) and {text.lower() for text in filled} <= TRUTH.keys()
        self.in_words = bool(filled) and all(map(is_time, filled))
        self.in_words |= self.is_numeric and bool(self.values.min(initial=0) > 1e8)
        self.largest = float(np.abs(self.values).max(initial=0.0))
        below = table.units[place] if table.units else ""
        title = f"{table.titles[place]} ({below})" if below else table.titles[place]
        unit = unit_of_title(title).unit
        self.quantity = "" if unit is None else unit.quantity
        self.unit = "" if unit is None else unit.symbol
        # A column `time` of numbers that are no time since 1970 needs a unit.
        self.are_read = not (is_timestamp_title(in_english(title)) and not self.in_words)
        self.increases = self.is_numeric and bool(np.all(np.diff(self.values) >= 0))


def _number(text: str) -> float | None:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return None


class _Names:
    """Names for channels and drives that no column has yet."""

    def __init__(self, rig: "Rig | None", taken: Sequence[str]):
        self.taken: set[str] = set()
        self._driven = () if rig is None else rig.driven
        self._channels = [] if rig is None else [channel.name for channel in rig.channels]
        for name in taken:
            self.take(name)

    def take(self, name: str) -> None:
        self.taken.add(re.sub(r"_(degC|degF|K|%|m?s)$", "", name))

    def next_channel(self) -> str:
        numbered = (f"T{number}" for number in range(1, len(self.taken) + 2))
        name = next(n for n in (*self._channels, *numbered) if n not in self.taken)
        self.taken.add(name)
        return name

    def next_drive(self) -> str:
        numbered = (f"P{number}" for number in range(1, len(self.taken) + 2))
        drives = (f"duty_{name}" for name in (*self._driven, *numbered))
        name = next(drive for drive in drives if drive not in self.taken)
        self.taken.add(name)
        return name


def _known(
    table: "TextTable", place: int, rig: "Rig | None", given: "ReadingOptions"
) -> str | None:
    """What a column is read as by its title or the given name; None if it would be refused."""
    from ..errors import RecordingError
    from ..io import Choices, meanings
    from ..rig import is_channel_name

    title = table.titles[place]
    named = {key: name for key, name in given.columns.items() if key in (title, str(place + 1))}
    choices = Choices(dict.fromkeys([title], next(iter(named.values()))) if named else {}, rig=rig)
    units = table.units[place : place + 1]
    try:
        (meaning,) = meanings([title], choices, units)
    except RecordingError:
        return None
    if meaning is None or meaning.kind == "unknown" or not choices.is_of_rig(meaning):
        return None
    # A title such as '101 <oven> (C)' is a temperature, but no name of a channel.
    is_named = meaning.kind != "temperature" or is_channel_name(meaning.name)
    return meaning.text if is_named else None


def _role(table: "TextTable", place: int, numbers: _Numbers, has_time: bool) -> str:
    title = table.titles[place].lower()

    def says(words: str) -> bool:
        return re.search(words, title) is not None

    untitled = not table.titles_at or re.fullmatch(NO_WORDS, title) is not None
    may_be_time = (
        says(TIME_WORDS) or numbers.quantity == "time" or untitled or table.titles[place] == "t"
    )
    if not has_time and (numbers.in_words or (numbers.increases and may_be_time)):
        return "time"
    if says(REFERENCE_WORDS) or not (numbers.is_numeric or numbers.is_truth) or numbers.in_words:
        return "none"
    if numbers.quantity in ("power", "voltage", "current", "duty") or numbers.is_truth:
        return "duty"
    if numbers.quantity != "temperature" and says(DUTY_WORDS):
        return "duty"
    if says(ROOM_WORDS):
        return "ambient"
    if numbers.quantity == "temperature" or says(TEMPERATURE_WORDS):
        return "temperature"
    if untitled and title:
        return "duty" if numbers.largest <= 1 else "temperature"
    return "none"


def _rows(table: "TextTable", roles: Sequence[str]) -> list[list[str]]:
    shown = [row for _, row in table.rows[:SHOWN_ROWS]]
    rows = []
    for place, (title, role) in enumerate(zip(table.titles, roles, strict=True)):
        unit = f" ({table.units[place]})" if table.units and table.units[place] else ""
        values = ", ".join(row[place][:24] if place < len(row) else "" for row in shown)
        rows.append([f"  {place + 1}", title[:40] + unit or "(no title)", f"{values}, ...", role])
    return rows


def _sampling(experiment: "Experiment") -> list[str]:
    """Sampling, gaps, ranges and glitches of the recording that the guess gives."""
    steps = np.diff(experiment.time)
    gaps = experiment.gaps
    every = f"every {np.median(steps):g} s ({steps.min():g} to {steps.max():g} s)"
    lines = [f"{len(steps) + 1} samples in {experiment.duration:g} s, {every}, gaps: {len(gaps)}"]
    lines += [f"  nothing from {before:g} s to {after:g} s" for before, after in gaps[:3]]
    for name, values in zip(experiment.channels, _temperatures(experiment).T, strict=True):
        there = ~np.isnan(values)
        if not there.any():
            continue
        lines.append(f"  {name}: {np.nanmin(values):.4g} to {np.nanmax(values):.4g} degC")
    lines += [f"  {glitch}" for glitch in experiment.glitches[:3]]
    return lines + [f"  {note}" for note in experiment.notes]


def _temperatures(experiment: "Experiment") -> np.ndarray:
    blank = np.full((len(experiment.time), len(experiment.channels)), np.nan)
    return blank if experiment.temperatures is None else experiment.temperatures
