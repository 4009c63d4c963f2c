"""The long form in which InfluxDB writes .csv files, a row for each value, as a table with a column
for each field."""

import csv
import io

from .._errors import RecordingError

TIME, FIELD, VALUE = "_time", "_field", "_value"
"""The columns of the long form that are used; tags and the name of the measurement are not."""


def widened(text: str) -> str:
    """The text of a file, in which the long form of InfluxDB has become a column for each field.

    A file may hold several tables, each with a line of names and annotations (`#datatype`).

    **Raises:** `RecordingError` if a field has two values at one time.
    """
    if not all(name in text[:10_000] for name in (TIME, FIELD, VALUE)):
        return text
    places: dict[str, int] = {}
    table: dict[str, dict[str, str]] = {}
    fields: dict[str, None] = {}
    try:
        for row in csv.reader(io.StringIO(text, newline=""), strict=True):
            if not any(row) or row[0].startswith("#"):
                continue
            if FIELD in row and VALUE in row and TIME in row:
                places = {name: row.index(name) for name in (TIME, FIELD, VALUE)}
                continue
            if not places:  # something else stands before the names
                return text
            if len(row) <= max(places.values()):
                raise RecordingError(f"expected {max(places.values()) + 1} fields, got {row}")
            time, field, value = (row[places[name]] for name in (TIME, FIELD, VALUE))
            at_time = table.setdefault(time, {})
            if at_time.setdefault(field, value) != value:
                raise RecordingError(
                    f"expected one value of {field!r} at {time}, got {at_time[field]} and {value}; "
                    "choose one of the tags before the export"
                )
            fields[field] = None
    except csv.Error as error:
        raise RecordingError(f"is no .csv file: {error}") from None
    wide = io.StringIO(newline="")
    writer = csv.writer(wide, lineterminator="\n")
    writer.writerow(["time", *fields])
    writer.writerows([time, *(table[time].get(f, "") for f in fields)] for time in sorted(table))
    return wide.getvalue()
