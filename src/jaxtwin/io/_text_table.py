"""Text as a table: its titles, found below whatever stands above them, and its rows.

The titles are in the first line that is no note and no blank line, if this line names the times or
what the reader names. Otherwise they are searched: in the note right above the numbers (`# a,b,c`
of `numpy.savetxt`), or in the line above the longest block of lines of numbers, below a preamble
(LabVIEW, Keysight). A row of units below the titles (Pico) belongs to them, and so does a unit
behind every number of a column (`21.5 °C`). Where LabVIEW writes no times, they follow from its
`Delta_X`.
"""

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import final

from ..errors import RecordingError
from ._column_meaning import Choices
from ._glitches import is_missing
from ._named_columns import meanings
from ._timestamps import is_time
from ._title_units import unit_called, unit_of_title

# The message about a file without samples.
EMPTY = "is empty: expected at least 2 samples, got none"

SEPARATORS = (",", ";", "\t")

# The number of lines in which titles are searched.
PREAMBLE = 2000

_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")


@final
@dataclass(frozen=True)
class TextTable:
    """The titles, the row of units or none, and the line number and fields of each row.

    - `titles_at`: the line of the titles, 0 if there is none.
    """

    titles: list[str]
    units: list[str]
    rows: list[tuple[int, list[str]]]
    separator: str
    titles_at: int


_WITH_UNIT = re.compile(
    rf"(?P<number>{_NUMBER.pattern})\s*(?P<unit>[^\W\d_]+|[%°º℃℉Ω]\s*[^\W\d_]*)"
)


def table_of_text(text: str, header: int | None = None, wanted: Collection[str] = ()) -> TextTable:
    """The table in the text of a file.

    **Arguments:**

    - `header`: the number of the line of titles; 0 if there are none, and columns are called by
      their numbers, from 1 on; None: it is searched.
    - `wanted`: titles or numbers that the reader names.

    **Raises:** `RecordingError` if there are no rows, and for a row that is none of a .csv file.
    """
    lines = text.splitlines()
    table = _table_of_lines(text, lines, header, wanted)
    return _with_units_of_fields(_with_times(table, lines))


def _table_of_lines(
    text: str, lines: Sequence[str], header: int | None, wanted: Collection[str]
) -> TextTable:
    if header == 0:
        return _without_titles(text, lines)
    if header is not None:
        if not 1 <= header <= len(lines):
            raise RecordingError(
                f"header: expected the number of a line, 1 to {len(lines)}, got {header}"
            )
        return _below(text, _separator_of_numbers(lines[header - 1]), header)
    first = next((k for k, line in enumerate(lines) if line.strip() and not _is_note(line)), None)
    if first is None:
        raise RecordingError(EMPTY)
    separator = _separator(lines[first])
    names = _fields(lines[first], separator)
    by_title = {title for title in wanted if not title.isdigit()}
    if by_title and not by_title <= {*names}:
        place = _with_titles(lines, by_title)
        if place is not None:
            return _below(text, place[1], place[0] + 1)
    elif by_title:
        return _below(text, separator, first + 1)
    # `Time,14:03:20` of a preamble is no line of titles.
    if any(map(_names_time, names)) and not any(map(is_time, names)):
        return _below(text, separator, first + 1)
    if is_data(_fields(lines[first], _separator_of_numbers(lines[first]))):
        return _below_note(text, lines, first)
    place, separator = _above_numbers(lines) or (first, separator)
    return _below(text, separator, place + 1)


def decoded(content: bytes) -> str:
    """The text of a file.

    **Raises:** `RecordingError` if it is none.
    """
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


def _without_titles(text: str, lines: Sequence[str]) -> TextTable:
    first = next((line for line in lines if line.strip() and not _is_note(line)), None)
    if first is None:
        raise RecordingError(EMPTY)
    separator = _separator_of_numbers(first)
    rows = [row for row in _rows(text, separator) if not _is_note(row[1][0])]
    titles = [str(number) for number in range(1, len(rows[0][1]) + 1)]
    return TextTable(titles, [], rows, separator, 0)


def _below_note(text: str, lines: Sequence[str], first: int) -> TextTable:
    """The table whose titles are in the note right above its numbers."""
    separator = _separator_of_numbers(lines[first])
    width = len(_fields(lines[first], separator))
    above = lines[first - 1] if first else ""
    note = re.sub(r"^\s*[#%]+\s*", "", above)
    for own in (separator, *SEPARATORS, " "):
        titles = _fields(note, own) if note else []
        if _is_note(above) and len(titles) == width > 1:
            rows = [row for row in _rows(text, separator) if row[0] > first]
            return TextTable(titles, [], rows, separator, first)
    return _below(text, separator, first + 1)


def _below(text: str, separator: str, line: int) -> TextTable:
    """The table whose titles are in a line, counted from 1. Notes below them are skipped up to the
    first row."""
    rows = [row for row in _rows(text, separator) if row[0] >= line]
    if rows and rows[0][0] == line and _is_note(rows[0][1][0]):
        # The reader has said that this note holds the titles.
        first, *others = rows[0][1]
        first = re.sub(r"^[#%]+\s*", "", first)
        rows[0] = (line, [first, *others] if first else others)
    if not rows:
        raise RecordingError(EMPTY)
    (at, titles), *rows = rows
    while rows and _is_note(rows[0][1][0]):
        rows = rows[1:]
    units: list[str] = []
    if rows and len(rows[0][1]) == len(titles) and (units := _units(rows[0][1])):
        rows = rows[1:]
    return TextTable(titles, units, rows, separator, at)


def _with_times(table: TextTable, lines: Sequence[str]) -> TextTable:
    """The table with the times that LabVIEW leaves out, its column `X_Value` being blank."""
    place = table.titles.index("X_Value") if "X_Value" in table.titles else -1
    if place < 0 or any(row[place] for _, row in table.rows):
        return table
    head = [_fields(line, table.separator) for line in lines[: table.titles_at]]
    stated = {fields[0]: fields[1] for fields in head if len(fields) > 1}
    step, start = stated.get("Delta_X", ""), stated.get("X0", "")
    if not _NUMBER.fullmatch(step):
        return table
    first, per = (float(number.replace(",", ".")) for number in (start or "0", step))
    rows = [
        (line, [*row[:place], f"{first + k * per:.12g}", *row[place + 1 :]])
        for k, (line, row) in enumerate(table.rows)
    ]
    return replace(table, rows=rows)


def _with_units_of_fields(table: TextTable) -> TextTable:
    """The table with the units that stand behind each number of a column beside its title."""
    titles = table.titles
    units = list(table.units) or [""] * len(titles)
    rows = table.rows
    for place in range(len(titles)):
        fields = [row[place] for _, row in rows if len(row) > place]
        filled = [field for field in fields if not is_missing(field)]
        if not filled or _number_with_unit(filled[0]) is None:
            continue
        matches = [match for field in filled if (match := _number_with_unit(field)) is not None]
        texts = {match["unit"] for match in matches}
        if len(matches) < len(filled) or len(texts) != 1:
            continue
        numbers = iter([match["number"] for match in matches])
        rows = [
            (line, [*row[:place], next(numbers), *row[place + 1 :]])
            if len(row) > place and not is_missing(row[place])
            else (line, row)
            for line, row in rows
        ]
        (units[place],) = texts
        _check_unit(titles[place], units[place])
    return replace(table, rows=rows, units=units if any(units) else [])


def _check_unit(title: str, text: str) -> None:
    """Refuses a column whose title and fields name different units."""
    of_title, of_fields = unit_of_title(title).unit, unit_called(text)
    if of_title is not None and of_fields is not None and of_title.symbol != of_fields.symbol:
        raise RecordingError(
            f"column {title}: expected fields in {of_title.symbol}, as its title says, got {text}; "
            "correct the file"
        )


def _number_with_unit(field: str) -> re.Match[str] | None:
    match = _WITH_UNIT.fullmatch(field)
    return match if match is not None and unit_called(match["unit"]) else None


def _units(fields: Sequence[str]) -> list[str]:
    """The units in a row that holds nothing else; none if it holds anything else."""
    texts = [re.sub(r"^[\[(](.*)[\])]$", r"\1", field).strip() for field in fields]
    are_units = [
        not field or text != field or unit_called(text) is not None
        for field, text in zip(fields, texts, strict=True)
    ]
    # A row of `1` and `-` is one of numbers and missing samples.
    named = [text for text in texts if text and not is_value(text)]
    return texts if named and all(are_units) else []


def _with_titles(lines: Sequence[str], titles: set[str]) -> tuple[int, str] | None:
    """The place of the first line that holds all of these titles, and its separator."""
    for place, line in enumerate(islice(lines, PREAMBLE)):
        if _is_note(line):
            continue
        for separator in (*SEPARATORS, " "):
            if titles <= {*_fields(line, separator)}:
                return place, separator
    return None


def _above_numbers(lines: Sequence[str]) -> tuple[int, str] | None:
    """The place of the line above the longest block of lines of numbers, and the separator with
    which it is the longest; None if there is none."""
    best: tuple[float, int, int, str] | None = None
    for separator in (*SEPARATORS, " "):
        start, count, width = 0, 0, 0
        rows = [_fields(line, separator) for line in islice(lines, PREAMBLE)]
        for place, fields in enumerate([*rows, []]):
            if count and not any(fields) and place < len(rows):
                continue  # a blank line ends no block
            if len(fields) > 1 and is_data(fields) and (not count or len(fields) == width):
                start, width = (start, width) if count else (place, len(fields))
                count += 1
                continue
            if count:
                above = _title_above(rows, start, width)
                score = (float(count), width)
                if above is not None and (best is None or score > best[:2]):
                    best = (*score, above, separator)
            start, count = place, 0
            if len(fields) > 1 and is_data(fields):
                count, width = 1, len(fields)
    return None if best is None else (best[2], best[3])


def _title_above(rows: Sequence[Sequence[str]], start: int, width: int) -> int | None:
    """The place of the titles above a block of numbers: past blank lines and a row of units."""
    above = [place for place in range(start) if any(rows[place])][-2:]
    if above and _units(rows[above[-1]]):
        above = above[:-1]
    if not above or abs(len(rows[above[-1]]) - width) > 1:
        return None
    names = [name for name in rows[above[-1]] if name]
    return above[-1] if len(names) > 1 and not is_data(rows[above[-1]]) else None


def is_data(fields: Sequence[str]) -> bool:
    """Whether a line begins with a number or a time and holds no text but some words."""
    filled = [field for field in fields if field]
    values = [field for field in filled if is_value(field)]
    return bool(filled) and is_value(filled[0]) and 2 * len(values) >= len(filled)


def is_value(text: str) -> bool:
    """Whether a field is a number, a time, or a word for a missing one."""
    is_number = bool(_NUMBER.fullmatch(text)) or _number_with_unit(text) is not None
    return is_number or is_time(text) or (bool(text) and is_missing(text))


def _names_time(title: str) -> bool:
    (meaning,) = meanings([title], Choices())
    return meaning is not None and meaning.kind == "time"


def _fields(line: str, separator: str) -> list[str]:
    """The fields of a line, of which quotes may be damaged."""
    if separator == " ":
        return line.split()
    row = next(csv.reader([line], delimiter=separator), [])
    return [field.strip() for field in row]


def _rows(text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """The line number and the fields of each row that is not blank.

    **Raises:** `RecordingError` for a row that is none of a .csv file.
    """
    if separator == " ":
        yield from (
            (number, line.split())
            for number, line in enumerate(text.splitlines(), start=1)
            if line.strip()
        )
        return
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        for row in reader:
            fields = [field.strip() for field in row]
            if any(fields):
                yield reader.line_num, fields
    except csv.Error as error:
        raise RecordingError(f"line {reader.line_num} is no line of a .csv file: {error}") from None


def _separator(line: str) -> str:
    """The separator of the line of titles."""
    names = re.sub(r'"[^"]*"', "", line)
    return max(*SEPARATORS, key=names.count)


def _separator_of_numbers(line: str) -> str:
    """The separator of a line of numbers: blanks, where there is no other."""
    separator = _separator(line)
    if ";" in line:  # beside which commas are decimal ones
        return ";"
    return separator if separator in line.strip() else " "


def _is_note(text: str) -> bool:
    """Whether a line before the line of titles is to be skipped."""
    return text.lstrip().startswith(("#", "% ", "sep="))
