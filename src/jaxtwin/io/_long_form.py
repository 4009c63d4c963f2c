"""The long form, a row for each value, as a table with a column for each name: what InfluxDB, Home
Assistant and many databases export."""

import csv
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..errors import RecordingError
from ._timestamps import times_of_fields

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
