"""Reads time stamps: ISO 8601, dates with dots and the day first, or numbers since 1970."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction

import numpy as np
from jaxtyping import Float

from .._errors import RecordingError

TITLES = frozenset({"time", "timestamp", "datetime", "date_time", "date time", "date/time", "date"})
"""Names of a column of time stamps, in small letters."""

EXPECTED = "2024-03-05 14:03:21.5 or 05.03.2024 14:03:21"
"""Examples, for messages."""

DOTTED = re.compile(
    r"(\d{1,2})\.(\d{1,2})\.(\d{4})([ T]+)(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?"
)


EPOCH_UNITS = {
    1e17: Fraction(1, 1000),
    1e14: Fraction(1),
    1e11: Fraction(1000),
    1e8: Fraction(1_000_000),
}
"""Microseconds in a unit of a time since 1970, by the smallest number of that unit that is taken
for one: ns, us, ms and s, from 1973 on."""


def is_timestamp_title(title: str) -> bool:
    """Whether a column of this name holds time stamps: those of all channels, such as `time`, or
    those of a single channel, such as `T1_time`."""
    word = title.strip().lower()
    return word in TITLES or (word.endswith("_time") and len(word) > len("_time"))


def microseconds_of_timestamps(
    fields: Sequence[str], title: str, lines: Sequence[int]
) -> Float[np.ndarray, " samples"]:
    """Time stamps as whole microseconds since 1970, which float64 holds exactly.

    **Arguments:**

    - `fields`: the text of the fields. `title`: the title of their column. `lines`: their line
      numbers, for messages.

    **Raises:** `RecordingError` that names the line of a field that is not a time stamp, or that
    has a time zone while others have none.
    """
    since_1970 = [_since_1970(field) for field in fields]
    if all(value is not None for value in since_1970):
        return np.array(since_1970, np.float64)
    found: list[datetime] = []
    for field, line in zip(fields, lines, strict=True):
        stamp = _timestamp(field)
        if stamp is None:
            plain = re.fullmatch(r"[-+]?[\d.,]+", field) is not None
            more = "; numbers need a unit, such as time_s" if plain else ""
            raise RecordingError(
                f"line {line}, column {title}: expected a time stamp such as {EXPECTED}, got "
                f"{field[:40]!r}{more}"
            )
        if (stamp.tzinfo is None) != ((found or [stamp])[0].tzinfo is None):
            raise RecordingError(
                f"line {line}, column {title}: expected time stamps that all have a time zone or "
                f"none, got {field[:40]!r}"
            )
        found.append(stamp)
    first = datetime(1970, 1, 1, tzinfo=found[0].tzinfo and UTC)
    return np.array([(stamp - first) // timedelta(microseconds=1) for stamp in found], np.float64)


def _since_1970(field: str) -> float | None:
    """A number that can only be a time since 1970, in us; None for anything else."""
    if not re.fullmatch(r"\d{9,19}(\.\d+)?([eE][+]?\d+)?|\d(\.\d+)?[eE][+]?\d+", field):
        return None
    number = Fraction(field)
    unit = next((unit for least, unit in EPOCH_UNITS.items() if number >= least), None)
    return None if unit is None else float(number * unit // 1)


def _timestamp(field: str) -> datetime | None:
    dotted = DOTTED.fullmatch(field)
    try:
        if dotted is None:
            # A day alone is no time of a sample.
            return datetime.fromisoformat(field.replace(",", ".")) if ":" in field else None
        day, month, year, _, hour, minute, second, part = dotted.groups()
        micro = int((part or "0")[:6].ljust(6, "0"))
        return datetime(
            int(year), int(month), int(day), int(hour), int(minute), int(second or 0), micro
        )
    except ValueError:
        return None
