"""Columns of numbers in text, as this program, spreadsheets, loggers and pandas write them.

- Columns are separated by commas, semicolons or tabs, as in the line of names. With semicolons and
  tabs, numbers may have a decimal comma, if the whole file uses it.
- The encoding is UTF-8, UTF-16 with its byte order mark, or Windows-1252.
- Lines before the names that start with `#`, Excel's `sep=;`, blank lines and lines of blank fields
  are skipped. So are a first column without a name (pandas' index), and blank columns without a
  name.
- A unit may follow its name as `T11_degC`, `T11 [degC]` or `T11 (°C)`.
- A column `time`, `timestamp`, `date` or the like holds time stamps (`_timestamps`), and a column
  `T1_time` those of the channel `T1`.
- A column of `True` and `False` holds 1 and 0.
- A column `input_lid` holds numbers, or names of states.
- The long form of InfluxDB, a row for each value, becomes a column for each field (`_influx`).
- An empty field or a word for "not available" is a missing sample, NaN.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import final

import numpy as np
from jaxtyping import Float

from .._errors import RecordingError
from ._influx import widened
from ._named_columns import named
from ._timestamps import TITLES, is_timestamp_title, microseconds_of_timestamps

MISSING = frozenset(
    {"", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "null", "none", "-", "--", "---"}
)
"""The words for a missing sample, in small letters."""

EMPTY = "is empty: expected at least 2 samples, got none"
"""The message about a file without samples."""

TIME = re.compile("[Tt]ime_(s|ms|min|h|us since 1970)")
"""The name of the column that every recording has."""

CELL = re.compile(r"(duty|pwm)_P([1-9]\d{0,3})(_%)?")
"""The name of the drive of a cell."""

TEMPERATURE = re.compile(r"(.+)_(degC|K)")
"""The name of a temperature."""

INPUT = re.compile(r"input_([^\W\d]\w*)")
"""The name of an input besides the duty."""

STAMPS = "time_us since 1970"
"""The end of the name of a column of time stamps."""

UNITS = {"°C": "degC", "C": "degC", "celsius": "degC", "kelvin": "K", "sec": "s", "seconds": "s"}
"""Other ways to write a unit."""


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file.

    - `title`: the title in the file. `name`: the name with its unit after an underscore, as in
      `T11_degC`; without a unit if this is "1", "-" or empty.
    - `values`: the numbers; NaN for a missing sample.
    - `lines`: the line numbers of the samples in the file. `fields`: their text.
    - `place`: the word for what `lines` counts, for messages.
    """

    title: str
    name: str
    values: Float[np.ndarray, " samples"]
    lines: list[int]
    fields: list[str]
    place: str = "line"

    @property
    def is_blank(self) -> bool:
        """Whether the column holds no number."""
        return bool(np.isnan(self.values).all())

    def complete(self) -> Float[np.ndarray, " samples"]:
        """The values of a column that must have no missing samples.

        **Raises:** `RecordingError` that names the line of the first missing one.
        """
        (missing,) = np.nonzero(np.isnan(self.values))
        if missing.size:
            k = missing[0]
            raise RecordingError(
                f"{self.place} {self.lines[k]}, column {self.title}: expected a number in every "
                f"{self.place}, "
                f"because only temperatures may be missing, got {self.fields[k]!r}"
            )
        return self.values


def read_columns(
    content: bytes,
    expected: str,
    names: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    own: Mapping[str, str] | None = None,
) -> tuple[list[Column], list[int]]:
    """The columns in the order of the file, and the lines of their samples.

    **Arguments:**

    - `content`: the whole file.
    - `expected`: the expected columns in words, for messages.
    - `names`, `ignore`: other names of columns, and columns to leave out, as in `read_recording`.
    - `own`: titles that a rig gives a meaning, title -> name: those of its inputs and drives.

    **Raises:** `RecordingError` that names the line and, if there is one, the column.
    """
    text = widened(_decoded(content))
    separator = _separator(text)
    rows_of_file = _rows(text, separator)
    found = names_of_titles(_titles(rows_of_file), names, ignore, own)
    kept = [name is not None for name in found]
    titles = [name for name in found if name is not None]
    _check_titles(titles, separator, expected)
    rows: list[list[str]] = []
    lines: list[int] = []
    for line, row in rows_of_file:
        if _is_note(row[0]) and not rows:
            continue
        if len(row) != len(kept):
            raise RecordingError(
                f"line {line}: expected {len(kept)} fields, one for each column, got {len(row)}"
            )
        rows.append(list(compress(row, kept)))
        lines.append(line)
    if not rows:
        raise RecordingError(EMPTY)
    columns = []
    # Loggers write fractions of seconds with a comma, whatever they do in numbers.
    is_number = [not is_timestamp_title(title) and not INPUT.fullmatch(title) for title in titles]
    numbers = (field for row in rows for field in compress(row, is_number))
    comma = separator != "," and any("," in field for field in numbers)
    for number, (title, fields) in enumerate(zip(titles, zip(*rows, strict=True), strict=True)):
        if not title and (number == 0 or not any(fields)):
            continue
        if not title:
            raise RecordingError(f"columns: {expected}, got no name for column {number + 1}")
        if is_timestamp_title(title):
            stamps = microseconds_of_timestamps(fields, title, lines)
            name = title[: -len("time")] + STAMPS if title.lower().endswith("_time") else STAMPS
            columns.append(Column(title, name, stamps, lines, list(fields)))
            continue
        truth = {field.lower() for field in fields} <= {"true", "false"}
        values = np.array([_truth(field) if truth else _number(field, comma) for field in fields])
        (wrong,) = np.nonzero(np.isinf(values))
        if wrong.size and INPUT.fullmatch(title):  # names of states
            values = np.full(len(fields), np.nan)
        elif wrong.size:
            k = wrong[0]
            form = "21,5, with a decimal comma as elsewhere in the file" if comma else "21.5"
            raise RecordingError(
                f"line {lines[k]}, column {title}: expected a finite number such as {form}, or "
                f"nothing where a temperature is missing, got {fields[k][:40]!r}"
            )
        columns.append(Column(title, column_name(title), values, lines, list(fields)))
    return columns, lines


def names_of_columns(
    content: bytes,
    names: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    own: Mapping[str, str] | None = None,
) -> dict[str, str | None]:
    """What each column is read as, title -> name; None for a column that is left out.

    **Raises:** `RecordingError` if the file is no text or holds nothing, or for a title that it
    does not have.
    """
    text = widened(_decoded(content))
    titles = _titles(_rows(text, _separator(text)))
    found = zip(titles, names_of_titles(titles, names, ignore, own), strict=True)
    return {title: name for title, name in found if title}


def names_of_titles(
    titles: Sequence[str],
    names: Mapping[str, str] | None,
    ignore: Sequence[str],
    own: Mapping[str, str] | None = None,
) -> list[str | None]:
    """The titles by which columns are read; None for those left out: see `named`."""
    own = own or {}
    found = named(titles, names, ignore, lambda title: title in own or _is_known(title))
    return [title if title is None else own.get(title, title) for title in found]


def _rows(text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """The line number and the fields of each row that is not blank.

    **Raises:** `RecordingError` for a row that is none of a .csv file.
    """
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in reader:
            fields = [field.strip() for field in row]
            if any(fields):
                yield reader.line_num, fields
    except csv.Error as error:
        raise RecordingError(f"line {reader.line_num} is no line of a .csv file: {error}") from None


def _titles(rows: Iterator[tuple[int, list[str]]]) -> list[str]:
    """The first row that is no note, which names the columns.

    **Raises:** `RecordingError` if there is none.
    """
    titles = next((row for _, row in rows if not _is_note(row[0])), None)
    if titles is None:
        raise RecordingError(EMPTY)
    return titles


def _decoded(content: bytes) -> str:
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    encodings = ("utf-16",) if marked else ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise RecordingError("is no recording: neither MATLAB nor netCDF, and no text")


def _separator(text: str) -> str:
    """The separator of the line of names."""
    lines = (line for line in text.splitlines() if line.strip() and not _is_note(line))
    names = re.sub(r'"[^"]*"', "", next(lines, ""))
    return max(",", ";", "\t", key=names.count)


def _is_note(text: str) -> bool:
    """Whether a line before the line of names is to be skipped."""
    return text.startswith(("#", "sep="))


def _check_titles(titles: list[str], separator: str, expected: str) -> None:
    if not any(TIME.fullmatch(column_name(title)) or is_timestamp_title(title) for title in titles):
        found = separator.join(titles)
        raise RecordingError(
            f"is no recording: its first line must name the columns, {expected}, got {found[:60]!r}"
        )
    twice = sorted({title for title in titles if title and titles.count(title) > 1})
    if twice:
        raise RecordingError(
            f"columns: expected each name once, got {', '.join(twice)} more than once"
        )


def column_name(title: str) -> str:
    """The title with its unit behind an underscore."""
    parts = re.fullmatch(r"(.*?)\s*(?:\[(.*)\]|\((.*)\)|_(°C))", title)
    if parts is None:
        return title
    name, *units = parts.groups(default="")
    unit = "".join(units).strip()
    unit = UNITS.get(unit, unit)
    return name if unit in ("", "1", "-") else f"{name}_{unit}"


def _is_known(title: str) -> bool:
    """Whether a title is read as it is."""
    name = column_name(title)
    forms = (TIME, CELL, INPUT, TEMPERATURE)
    return title.lower() in TITLES or any(form.fullmatch(name) for form in forms)


def _truth(field: str) -> float:
    """Returns 1 for an output that is on, and 0 for one that is off."""
    return float(field.lower() == "true")


def _number(field: str, comma: bool) -> float:
    """Returns the number in a field; NaN for a missing sample, and infinity if the text is not a
    number."""
    if field.lower() in MISSING:
        return float("nan")
    if comma and "." in field:
        return float("inf")  # which of the two is the decimal mark?
    try:
        # float() would read 1_000 as a thousand
        number = float("inf" if "_" in field else field.replace(",", "." if comma else ","))
    except ValueError:
        return float("inf")
    return float("inf") if number != number else number
