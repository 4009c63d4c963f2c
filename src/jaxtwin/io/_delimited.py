"""Columns of numbers in text, as this program, spreadsheets, loggers and pandas write them.

- Columns are separated by commas, semicolons, tabs or, where none of these is there, blanks. Beside
  semicolons and tabs, numbers may have a decimal comma, if the whole file uses it.
- The encoding is UTF-8, UTF-16 with its byte order mark, or Windows-1252.
- Where the titles are, `_text_table` finds. A first column without a title (pandas' index) is
  skipped, or holds the times; blank columns without a title are skipped.
- What a title means, with its unit, `_named_columns` says.
- A column `time`, `timestamp`, `date` or the like holds times in words (`_timestamps`), and a
  column `T1_time` those of the channel `T1`. Two columns may hold a date and a time of the day.
- A column of `on` and `off`, or of other words for them, holds 1 and 0.
- A column `input_lid` holds numbers, or names of states.
- The long form, a row for each value, becomes a column for each name (`widened`).
- An empty field or a word for "not available" is a missing sample, NaN.
"""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError
from ._column_meaning import Choices, Kind, Meaning
from ._glitches import is_missing
from ._named_columns import meanings
from ._text_table import EMPTY, SEPARATORS, TextTable, decoded, table_of_text
from ._timestamps import is_date, is_time, times_of_fields

# The long form, a row for each value, as a table with a column for each name: what InfluxDB,
# Home Assistant and many databases export.


# The titles of the three columns of the long form, in small letters, the first that is there.
# Others, such as tags and the name of a measurement, are not used.
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "time": ("_time", "last_changed", "last_updated", "time", "timestamp", "datetime", "date"),
    "name": (
        *("_field", "entity_id", "entity", "sensor", "sensor_id", "signal", "series", "metric"),
        *("variable", "field", "topic", "tag", "name", "parameter"),
    ),
    "value": ("_value", "state", "value", "reading"),
}


def widened(text: str, separator: str) -> str:
    """The text of a file, in which the long form has become a column for each name.

    A file may hold several tables, each with a line of titles and annotations (`#datatype`).

    **Raises:** `RecordingError` if a name has two values at one time.
    """
    head = text[:10_000].lower()
    if not all(any(title in head for title in titles) for titles in COLUMNS.values()):
        return text
    places: dict[str, int] | None = None
    table: dict[str, dict[str, str]] = {}
    counts: Counter[str] = Counter()
    try:
        for row in csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True):
            fields = [field.strip() for field in row]
            if not any(fields) or fields[0].startswith(("#", "sep=")):
                continue
            if (of_titles := _places(fields)) is not None:
                places = of_titles
                continue
            if places is None:  # the first line has other titles
                return text
            if len(fields) <= max(places.values()):
                raise RecordingError(f"expected {max(places.values()) + 1} fields, got {row}")
            time, name, value = (fields[places[column]] for column in COLUMNS)
            at_time = table.setdefault(time, {})
            if at_time.setdefault(name, value) != value:
                raise RecordingError(
                    f"expected one value of {name!r} at {time}, got {at_time[name]} and {value}; "
                    "choose one of the tags before the export"
                )
            counts[name] += 1
    except csv.Error as error:
        raise RecordingError(f"is no .csv file: {error}") from None
    if places is None or (2 * len(counts) > sum(counts.values()) and not _is_sure(head)):
        return text
    wide = io.StringIO(newline="")
    writer = csv.writer(wide, lineterminator="\n")
    writer.writerow(["time", *counts])
    writer.writerows([time, *(table[time].get(n, "") for n in counts)] for time in _sorted(table))
    return wide.getvalue()


def _is_sure(head: str) -> bool:
    """Whether the titles are those of a program whose exports are always in the long form. Others
    may be those of a wide table in which each row has a name of its own."""
    return "_field" in head or "entity_id" in head


def _sorted(times: Iterable[str]) -> list[str]:
    """Times in their order, which is not that of their text: 20.4Z is before 20Z."""
    texts = list(times)
    try:
        values = times_of_fields(texts, "time", range(len(texts))).values
    except RecordingError:  # of the first that is wrong, which the reader of the table names
        return texts
    return [texts[place] for place in np.argsort(values, kind="stable")]


def _places(fields: Sequence[str]) -> dict[str, int] | None:
    """The places of time, name and value in a line of titles; None if it is none of a long form."""
    titles = [field.lower() for field in fields]
    places = {
        column: next((titles.index(word) for word in words if word in titles), None)
        for column, words in COLUMNS.items()
    }
    known = {column: place for column, place in places.items() if place is not None}
    return known if len(known) == len(COLUMNS) else None


TRUTH: dict[str, float] = {}
TRUTH |= dict.fromkeys(("true", "on", "yes", "ein", "heating", "active"), 1.0)
TRUTH |= dict.fromkeys(("false", "off", "no", "aus", "idle", "inactive"), 0.0)
"""Words for an output that is on or off, in small letters."""


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file.

    - `title`: the title in the file. `kind`, `name`: what it is read as, the name without a unit.
    - `values`: the numbers in the unit of the kind, degC, s or 1; NaN for a missing sample. Time
      stamps are in us since 1970, and `is_since_1970` is True.
    - `lines`: the line numbers of the samples in the file. `fields`: their text.
    - `place`: the word for what `lines` counts, for messages.
    - `note`: what a reader of the file should know about it; empty if nothing.
    """

    title: str
    kind: Kind
    name: str
    values: Float[np.ndarray, " samples"]
    lines: Sequence[int]
    fields: list[str]
    place: str = "line"
    is_since_1970: bool = False
    note: str = ""

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
                f"{self.place}, got {self.fields[k]!r}"
            )
        return self.values


def read_columns(
    content: bytes, expected: str, choices: Choices, header: int | None = None
) -> tuple[list[Column], list[int]]:
    """The columns in the order of the file, and the lines of their samples.

    **Arguments:**

    - `content`: the whole file.
    - `expected`: the expected columns in words, for messages.
    - `choices`: other names of columns, units, and columns to leave out.
    - `header`: the line of the titles, as in `table_of_text`.

    **Raises:** `RecordingError` that names the line and, if there is one, the column.
    """
    table = text_table(content, choices, header)
    meant = meanings(table.titles, choices, table.units)
    if not table.rows:
        _check_titles(meant, table, expected)
        raise RecordingError(EMPTY)
    fields, lines = _fields_of_columns(table, meant)
    meant = _with_index(meant, table, fields)
    _check_titles(meant, table, expected)
    columns = [
        (meaning, values)
        for place, (meaning, values) in enumerate(zip(meant, fields, strict=True))
        if meaning is not None and _is_read(meaning, place, values, choices, expected)
    ]
    # Loggers write fractions of seconds with a comma, whatever they do in numbers.
    comma = table.separator != "," and any(
        "," in field and not is_time(field)
        for meaning, values in columns
        if meaning.kind not in ("time", "own time", "input")
        for field in values
    )
    columns = _with_joined_date(columns)
    return [_column(meaning, values, lines, comma) for meaning, values in columns], lines


def text_table(content: bytes, choices: Choices, header: int | None) -> TextTable:
    """The titles and rows of a file, in which the long form is wide."""
    text = decoded(content)
    head = text[:10_000]
    text = widened(text, max(SEPARATORS, key=head.count))
    return table_of_text(text, header, {*choices.columns})


def names_of_columns(
    content: bytes, choices: Choices, header: int | None = None
) -> dict[str, str | None]:
    """What each column is read as, title -> name; None for a column that is left out. A column
    without a title that holds something is called by its number.

    **Raises:** `RecordingError` if the file is no text or holds nothing, or for a title that it
    does not have.
    """
    table = text_table(content, choices, header)
    names: dict[str, str | None] = {}
    for place, meaning in enumerate(meanings(table.titles, choices, table.units)):
        if title := table.titles[place]:
            names[title] = meaning and meaning.text
        elif place and any(row[place] for _, row in table.rows if len(row) > place):
            is_named = meaning is not None and meaning.kind != "unknown"
            names[str(place + 1)] = meaning.text if is_named and meaning else None
    return names


def _fields_of_columns(
    table: TextTable, meant: Sequence[Meaning | None]
) -> tuple[list[list[str]], list[int]]:
    """The fields of each column, and the lines of the rows.

    **Raises:** `RecordingError` for a row of another length, unless fields at its end are blank, or
    are missing from columns that are left out.
    """
    kept = [meaning is not None for meaning in meant]
    width, needed = len(kept), max((k + 1 for k, keep in enumerate(kept) if keep), default=0)
    rows = []
    for line, row in table.rows:
        if (len(row) > width and any(row[width:])) or len(row) < needed:
            raise RecordingError(
                f"line {line}: expected {width} fields, one for each column, got {len(row)}"
            )
        rows.append([*row[:width], *[""] * (width - len(row))])
    return [list(column) for column in zip(*rows, strict=True)], [line for line, _ in table.rows]


def _with_index(
    meant: list[Meaning | None], table: TextTable, fields: Sequence[Sequence[str]]
) -> list[Meaning | None]:
    """What the columns are read as, where a first one without a title holds the times, as pandas
    writes its index."""
    first = meant[0]
    has_time = any(meaning is not None and meaning.kind == "time" for meaning in meant)
    if first is None or table.titles[0] or has_time or not all(map(is_time, fields[0])):
        return meant
    return [Meaning("time", "time", "time"), *meant[1:]]


def _is_read(
    meaning: Meaning, place: int, fields: Sequence[str], choices: Choices, expected: str
) -> bool:
    """Whether a column without a title is one all the same.

    **Raises:** `RecordingError` if it holds something.
    """
    if meaning.title or meaning.kind != "unknown":
        return True
    if place and any(fields) and "*" not in choices.ignore:
        raise RecordingError(f"columns: {expected}, got no name for column {place + 1}")
    return False


def _check_titles(meant: Sequence[Meaning | None], table: TextTable, expected: str) -> None:
    if not any(meaning is not None and meaning.kind == "time" for meaning in meant):
        titles = table.separator.join(table.titles)
        raise RecordingError(
            f"is no recording: its titles must name the columns, {expected}, got "
            f"{titles[:60]!r}; columns= names a column of the times time or time_s, and header=0 "
            "is for a file without titles, in a command --column and --no-header"
        )
    titles = [m.title for m in meant if m is not None and m.kind != "unknown" and m.title]
    twice = sorted({title for title in titles if titles.count(title) > 1})
    if twice:
        raise RecordingError(
            f"columns: expected each name once, got {', '.join(twice)} more than once"
        )


def _with_joined_date(
    columns: Sequence[tuple[Meaning, list[str]]],
) -> list[tuple[Meaning, list[str]]]:
    """The columns, where two for the date and the time of the day have become one."""
    times = [k for k, (meaning, _) in enumerate(columns) if meaning.kind == "time"]
    days = [k for k in times if all(map(is_date, columns[k][1]))]
    if len(times) != 2 or len(days) != 1:
        return [*columns]
    (day,), (clock,) = days, [k for k in times if k not in days]
    meaning = columns[clock][0]._replace(
        title=f"{columns[day][0].title}, {columns[clock][0].title}"
    )
    joined = [f"{d} {t}" for d, t in zip(columns[day][1], columns[clock][1], strict=True)]
    kept = [(meaning, joined) if k == clock else pair for k, pair in enumerate(columns)]
    return [pair for k, pair in enumerate(kept) if k != day]


def _column(meaning: Meaning, fields: list[str], lines: list[int], comma: bool) -> Column:
    """The column of the fields of a file.

    **Raises:** `RecordingError` that names the line of a field that is no number.
    """
    title, kind = meaning.title, meaning.kind
    in_words = meaning.unit is None or (bool(fields) and ":" in fields[0])
    if kind in ("time", "own time") and in_words:
        times = times_of_fields(fields, title, lines)
        since = times.unit != "s"
        return Column(
            *(title, kind, meaning.name, times.values, lines, fields, "line"),
            is_since_1970=since,
            note=times.note,
        )
    words: set[str] = set()
    if kind != "temperature" and next(filter(None, fields), "").lower() in TRUTH:
        words = {field.lower() for field in fields if not is_missing(field)}
    is_truth = bool(words) and words <= TRUTH.keys()
    values = np.array(
        [
            TRUTH.get(field.lower(), np.nan) if is_truth else _number(field, comma)
            for field in fields
        ]
    )
    (wrong,) = np.nonzero(np.isinf(values))
    if kind == "input" and (wrong.size or (is_truth and words - {"true", "false"})):
        values = np.full(len(fields), np.nan)  # names of states
    elif wrong.size and kind != "unknown":
        k = wrong[0]
        form = "21,5, with a decimal comma as elsewhere in the file" if comma else "21.5"
        raise RecordingError(
            f"line {lines[k]}, column {title}: expected a finite number such as {form}, or "
            f"nothing where a temperature is missing, got {fields[k][:40]!r}"
        )
    return Column(title, kind, meaning.name, in_unit(meaning, values), lines, fields)


def in_unit(
    meaning: Meaning, values: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, " samples"]:
    """The numbers of a column in degC, s or 1, or in the unit of an input."""
    scaled = values if meaning.scale == 1.0 else values * meaning.scale
    return scaled if meaning.unit is None else meaning.unit.converted(scaled)


def _number(field: str, comma: bool) -> float:
    """Returns the number in a field; NaN for a missing sample, and infinity if the text is not a
    number."""
    if is_missing(field):
        return float("nan")
    if comma and "." in field:
        return float("inf")  # which of the two is the decimal mark?
    try:
        # float() would read 1_000 as a thousand
        number = float("inf" if "_" in field else field.replace(",", "." if comma else ","))
    except ValueError:
        return float("inf")
    return float("inf") if number != number else number
