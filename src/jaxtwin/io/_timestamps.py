"""Reads time stamps as text: ISO 8601, or dates with dots and the day first."""

import re
from collections.abc import Sequence
from datetime import datetime

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


def is_timestamp_title(title: str) -> bool:
    """Whether a column of this name holds time stamps."""
    return title.strip().lower() in TITLES


def seconds_of_timestamps(
    fields: Sequence[str], title: str, lines: Sequence[int]
) -> Float[np.ndarray, " samples"]:
    """Seconds since the first of several time stamps.

    **Arguments:**

    - `fields`: the text of the fields. `title`: the title of their column. `lines`: their line
      numbers, for messages.

    **Raises:** `RecordingError` that names the line of a field that is not a time stamp, or that
    has a time zone while others have none.
    """
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
    return np.array([(stamp - found[0]).total_seconds() for stamp in found])


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
