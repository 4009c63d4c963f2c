"""Names that a reader of a file gives its columns, and columns that are left out."""

import re
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from .._arguments import is_ordered, mapping_of
from .._errors import RecordingError
from .._name_suggestions import did_you_mean

WORDS = {
    "zeit": "time",
    "zeitstempel": "timestamp",
    "datum": "date",
    "datum/uhrzeit": "date/time",
    "datum/zeit": "date/time",
    "umgebung": "ambient",
    "umgebungstemperatur": "ambient",
    "raumtemperatur": "ambient",
}
"""German names of columns, in small letters, and the names by which they are read."""

WITHOUT_UNIT = re.compile(r"(?:duty|pwm)_P\d+|(?:.+_)?time|timestamp|date|input_\w+", re.IGNORECASE)
"""Names that a reader gives and that need no unit."""


def named(
    titles: Sequence[str],
    columns: Mapping[str, str] | None,
    ignore: Sequence[str],
    is_known: Callable[[str], bool],
) -> list[str | None]:
    """The titles by which columns are read, in the order of the file; None for those left out.

    **Arguments:**

    - `titles`: the titles in the file.
    - `columns`: a name for some of them, as in `read_recording`. A temperature without a unit keeps
      that of its title, or is in degC.
    - `ignore`: the titles that are left out; `*` and `?` stand for any characters. A title that
      `columns` names is never left out. `"*"` alone leaves out all that would be refused.
    - `is_known`: whether a title is read as it is.

    **Raises:** `RecordingError` for a title that the file does not have.
    """
    mapping_of("columns", columns or {}, "title in the file -> name", RecordingError)
    chosen: dict[str, Any] = dict(columns or {})
    unknown = [title for title in chosen if title not in titles]
    unknown += [
        pattern
        for pattern in _patterns(ignore)
        if pattern != "*" and not any(fnmatchcase(title, pattern) for title in titles)
    ]
    if unknown:
        known = ", ".join(title for title in titles if title)
        raise RecordingError(
            f"columns: expected titles of the file, {known}, got {', '.join(unknown)}"
            f"{did_you_mean(unknown, titles)}"
        )
    return [_name(title, chosen, ignore, is_known) for title in titles]


def _patterns(ignore: Sequence[str]) -> Sequence[str]:
    if not is_ordered(ignore) or not all(isinstance(pattern, str) for pattern in ignore):
        raise RecordingError(f"ignore: expected a list of titles, got {ignore!r}")
    return ignore


def _name(
    title: str,
    columns: Mapping[str, str],
    ignore: Sequence[str],
    is_known: Callable[[str], bool],
) -> str | None:
    if title not in columns:
        english = in_english(title)
        refused = not is_known(english)
        patterns = [pattern for pattern in ignore if pattern != "*" or refused]
        return None if title and any(fnmatchcase(title, p) for p in patterns) else english
    name = columns[title]
    if not isinstance(name, str) or not name:
        raise RecordingError(f"columns: expected a name for {title!r}, got {name!r}")
    if WITHOUT_UNIT.fullmatch(name) or re.search(r"_(degC|K|s|ms|min|h|%)$|[\])]$", name):
        return name
    unit = re.search(r"_(degC|K|°C)$|\s*[\[(][^\[(]*[\])]$", title)
    return name + (unit[0] if unit else "_degC")


def in_english(title: str) -> str:
    """A title whose first word is German, by its English name; others as they are."""
    word = re.match(r"[A-Za-zÄÖÜäöüß]+(?:/[A-Za-z]+)?", title)
    if word is None or word[0].lower() not in WORDS:
        return title
    rest = title[word.end() :]
    return (
        title
        if re.match(r"[ ]*\w", rest) and not rest.startswith("_")
        else (WORDS[word[0].lower()] + rest)
    )
