"""Reads times in words: time stamps, times of the day, elapsed times, or numbers since 1970.

Dates are ISO 8601, with dots and the day first, with slashes, or with the name of a month. Of dates
with slashes the order of day and month is that of the whole column: the only one that is possible,
or in which the samples follow each other within a day. Where both are, they give the same times.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import NamedTuple, NoReturn, final

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError

# Names of a column of time stamps, in small letters.
TITLES = frozenset({"time", "timestamp", "datetime", "date_time", "date time", "date/time", "date"})

# Examples, for messages.
EXPECTED = "2024-03-05 14:03:21.5, 05.03.2024 14:03:21 or 14:03:21"

# Microseconds in a unit of a time since 1970, by the smallest number of that unit that is taken for
# one: ns, us, ms and s, from 1973 on.
EPOCH_UNITS = {
    1e17: Fraction(1, 1000),
    1e14: Fraction(1),
    1e11: Fraction(1000),
    1e8: Fraction(1_000_000),
}

DAY = 86400.0  # s

_CLOCK = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,:](\d+))?)?\s*([AaPp]\.?[Mm]\.?)?"
_DOTTED = re.compile(rf"(\d{{1,2}})\.(\d{{1,2}})\.(\d{{4}})[ T]+{_CLOCK}")
_SLASHED = re.compile(rf"(\d{{1,4}})[/-](\d{{1,2}})[/-](\d{{1,4}})[ T,]+{_CLOCK}")
_NAMED = re.compile(rf"(\d{{1,2}})[ .-]+([A-Za-z]{{3}})[a-z]*[ .-]+(\d{{4}})[ ,T]+{_CLOCK}")
_AMERICAN = re.compile(rf"([A-Za-z]{{3}})[a-z]*\.? +(\d{{1,2}}),? +(\d{{4}})[ ,]+{_CLOCK}")
_DATE = re.compile(r"\d{1,4}([./-])(\d{1,2}|[A-Za-z]{3,9})\1\d{1,4}")
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_ELAPSED = re.compile(
    r"(?:(\d+) ?d(?:ays?)?[ ,]+)?(\d+):(\d\d):(\d\d)(?:[.,:](\d+))?\s*([AaPp]\.?[Mm]\.?)?"
)
_MINUTES = re.compile(r"(\d+):(\d\d)[.,](\d+)")
_SHORT = re.compile(r"(\d+):(\d\d)")
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")


@final
class Times(NamedTuple):
    """The times of a column.

    - `unit`: `"us since 1970"`, or `"s"` of elapsed times and of times of a day.
    - `note`: what a reader of the file should know; empty if nothing.
    """

    values: Float[np.ndarray, " samples"]
    unit: str
    note: str = ""


def is_timestamp_title(title: str) -> bool:
    """Whether a column of this name holds time stamps: those of all channels, such as `time`, or
    those of a single channel, such as `T1_time`."""
    word = title.strip().lower()
    return word in TITLES or (word.endswith("_time") and len(word) > len("_time"))


def is_time(field: str) -> bool:
    """Whether a text may be a time, a date, or both."""
    forms = (_DATE, _ELAPSED, _MINUTES, _SHORT, _ISO, _SLASHED, _DOTTED, _NAMED, _AMERICAN)
    return any(form.fullmatch(field) for form in forms)


def is_date(field: str) -> bool:
    """Whether a text is a day without a time."""
    return _DATE.fullmatch(field) is not None


def times_of_fields(fields: Sequence[str], title: str, lines: Sequence[int]) -> Times:
    """The times in the fields of a column.

    **Arguments:**

    - `fields`: the text of the fields. `title`: the title of their column, which may say which of
      `mm:ss` and `hh:mm` they are. `lines`: their line numbers, for messages.

    **Raises:** `RecordingError` that names the line of a field that is no time, or that has a time
    zone while others have none.
    """
    since_1970 = [_since_1970(field) for field in fields]
    if all(value is not None for value in since_1970):
        return Times(np.array(since_1970, np.float64), "us since 1970")
    if fields and _elapsed(fields[0], title) is not None:
        return _elapsed_times(fields, title, lines)
    if fields and _SLASHED.fullmatch(fields[0]) and not _ISO.fullmatch(fields[0]):
        return _slashed_times(fields, title, lines)
    stamps = [_timestamp(field) for field in fields]
    return Times(_microseconds(stamps, fields, title, lines), "us since 1970")


def _since_1970(field: str) -> float | None:
    """A number that can only be a time since 1970, in us; None for anything else."""
    if not re.fullmatch(r"\d{9,19}(\.\d+)?([eE][+]?\d+)?|\d(\.\d+)?[eE][+]?\d+", field):
        return None
    number = Fraction(field)
    unit = next((unit for least, unit in EPOCH_UNITS.items() if number >= least), None)
    return None if unit is None else float(number * unit // 1)


def _elapsed_times(fields: Sequence[str], title: str, lines: Sequence[int]) -> Times:
    """Elapsed times or times of a day, s. Where they fall by more than half a day, it is the next
    day."""
    seconds = []
    for field, line in zip(fields, lines, strict=True):
        value = _elapsed(field, title)
        if value is None:
            _refuse(field, title, line)
        seconds.append(value)
    values = np.array(seconds, np.float64)
    days = np.cumsum(np.append(0, np.diff(values) < -DAY / 2))
    return Times(values + DAY * days, "s")


def _elapsed(field: str, title: str) -> float | None:
    form = re.search(r"\b(hh?:mm|mm?:ss)\b(?!:)", title.lower())
    if form and (short := _SHORT.fullmatch(field)):
        first, second = int(short[1]), int(short[2])
        return 60.0 * (60 * first + second) if form[1].startswith("h") else 60.0 * first + second
    if minutes := _MINUTES.fullmatch(field):
        return 60.0 * int(minutes[1]) + float(f"{minutes[2]}.{minutes[3]}")
    parts = _ELAPSED.fullmatch(field)
    if parts is None:
        return None
    days, hour, minute, second, part, half = parts.groups()
    if int(minute) > 59 or int(second) > 59 or (half and int(hour) > 12):
        return None
    seconds = 3600 * _hour(int(hour), half) + 60 * int(minute) + DAY * int(days or 0)
    return seconds + float(f"{second}.{part or 0}")


def _slashed_times(fields: Sequence[str], title: str, lines: Sequence[int]) -> Times:
    """Time stamps of dates with slashes, in the order of day and month of the whole column."""
    parts = [_SLASHED.fullmatch(field) for field in fields]
    for field, line, match in zip(fields, lines, parts, strict=True):
        if match is None:
            _refuse(field, title, line)
    groups = [match.groups() for match in parts if match is not None]
    orders = ("ymd",) if len(groups[0][0]) > 2 else ("mdy", "dmy")
    readings: dict[str, Float[np.ndarray, " samples"]] = {}
    for order in orders:
        places = [order.index(letter) for letter in "dmy"]
        stamps = [_stamp(*(group[k] for k in places), *group[3:]) for group in groups]
        if None not in stamps:
            readings[order] = _microseconds(stamps, fields, title, lines)
    if not readings:
        _refuse(fields[0], title, lines[0])
    steps = {order: np.diff(values) for order, values in readings.items()}
    names = {"mdy": "month/day/year", "dmy": "day/month/year", "ymd": "year/month/day"}
    if len(readings) == 2 and not np.array_equal(steps["mdy"], steps["dmy"]):
        near = [o for o, s in steps.items() if np.all(s >= 0) and np.all(s < 1e6 * DAY)]
        if len(near) != 1:
            raise RecordingError(
                f"column {title}: expected dates of which the order of day and month is clear, got "
                f"{fields[0]!r}, ...; write them as 2024-03-05"
            )
        note = f"dates of {title} are read as {names[near[0]]}"
        return Times(readings[near[0]], "us since 1970", note)
    return Times(next(iter(readings.values())), "us since 1970")


def _timestamp(field: str) -> datetime | None:
    if parts := _DOTTED.fullmatch(field):
        day, month, year, *clock = parts.groups()
        return _stamp(day, month, year, *clock)
    for form, order in ((_NAMED, (0, 1)), (_AMERICAN, (1, 0))):
        if parts := form.fullmatch(field):
            *named, year = parts.groups()[:3]
            day, month = (named[place] for place in order)
            clock = parts.groups()[3:]
            known = month.lower() in _MONTHS
            number = str(_MONTHS.index(month.lower()) + 1) if known else "0"
            return _stamp(day, number, year, *clock)
    if parts := _SLASHED.fullmatch(field):
        year, month, day, *clock = parts.groups()
        return _stamp(day, month, year, *clock) if len(year) == 4 else None
    try:
        # A day alone is no time of a sample.
        text = re.sub(r" ?(UTC|GMT)$", "Z", field).replace(",", ".")
        return datetime.fromisoformat(text) if ":" in field else None
    except ValueError:
        return None


def _stamp(
    day: str,
    month: str,
    year: str,
    hour: str,
    minute: str,
    second: str | None,
    part: str | None,
    half: str | None,
) -> datetime | None:
    century = 2000 if len(year) == 2 else 0
    micro = int((part or "0")[:6].ljust(6, "0"))
    try:
        return datetime(
            century + int(year),
            int(month),
            int(day),
            _hour(int(hour), half),
            int(minute),
            int(second or 0),
            micro,
        )
    except ValueError:
        return None


def _hour(hour: int, half: str | None) -> int:
    """The hour of 24, of one before or after noon."""
    return hour if not half else hour % 12 + 12 * (half[0] in "Pp")


def _microseconds(
    stamps: Sequence[datetime | None], fields: Sequence[str], title: str, lines: Sequence[int]
) -> Float[np.ndarray, " samples"]:
    """Time stamps as whole microseconds since 1970, which float64 holds exactly."""
    checked: list[datetime] = []
    for stamp, field, line in zip(stamps, fields, lines, strict=True):
        if stamp is None:
            _refuse(field, title, line)
        if (stamp.tzinfo is None) != ((checked or [stamp])[0].tzinfo is None):
            raise RecordingError(
                f"line {line}, column {title}: expected time stamps that all have a time zone or "
                f"none, got {field[:40]!r}"
            )
        checked.append(stamp)
    first = datetime(1970, 1, 1, tzinfo=checked[0].tzinfo and UTC)
    return np.array([(s - first) // timedelta(microseconds=1) for s in checked], np.float64)


def _refuse(field: str, title: str, line: int) -> NoReturn:
    plain = re.fullmatch(r"[-+]?[\d.,]+", field) is not None
    more = "; numbers need a unit, such as time_s" if plain else ""
    if _SHORT.fullmatch(field):
        more = "; is it (mm:ss) or (hh:mm)? The title of the column may say it"
    raise RecordingError(
        f"line {line}, column {title}: expected a time such as {EXPECTED}, got {field[:40]!r}{more}"
    )
