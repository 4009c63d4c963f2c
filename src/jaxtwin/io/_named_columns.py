"""What the columns of a file mean: names that a reader of the file gives them, and columns that are
left out."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from .._name_suggestions import did_you_mean
from ..errors import RecordingError
from ._column_meaning import Choices, Meaning, in_english, meaning_of_name, meaning_of_title


def meanings(
    titles: Sequence[str], choices: Choices, units: Sequence[str] = ()
) -> list[Meaning | None]:
    """What the columns are read as, in the order of the file; None for those left out.

    **Arguments:**

    - `titles`: the titles in the file.
    - `choices`: names for some of them, by title or, where no title is a number, by the number of
      the column, from 1 on. Titles that `ignore` matches are left out, but none that has a name.
      `"*"` alone leaves out all that would be refused.
    - `units`: the row of units below the titles, if there is one.

    **Raises:** `RecordingError` for a title that the file does not have, and for a title whose unit
    contradicts its name.
    """
    chosen = _by_place(titles, choices, units)
    placed = dict(chosen)
    result: list[Meaning | None] = []
    for place, title in enumerate(titles):
        whole = f"{title} ({units[place]})" if units and units[place] else title
        if place in placed:
            result.append(meaning_of_name(whole, placed[place], choices)._replace(title=title))
            continue
        meaning = meaning_of_title(in_english(whole), choices)._replace(title=title)
        refused = meaning.kind == "unknown" or not choices.is_of_rig(meaning)
        patterns = [p for p in choices.ignore if p != "*" or refused]
        # A blank title is read as an index where it is one; `*` leaves out what is none.
        out = title and any(fnmatchcase(title, pattern) for pattern in patterns)
        result.append(None if out else meaning)
    if "*" in choices.ignore:
        # Two columns of a quantity: the one that has a name, or else the first.
        taken = {result[place].name for place in placed if result[place] is not None}  # pyright: ignore
        for place, meaning in enumerate(result):
            if meaning is None or place in placed or meaning.kind == "unknown":
                continue
            if meaning.name in taken and meaning.kind != "time":
                result[place] = None
            taken.add(meaning.name)
    _check_scales(result, choices)
    return _with_one_time(result, placed, "*" in choices.ignore)


def _check_scales(result: Sequence[Meaning | None], choices: Choices) -> None:
    """Refuses a scale that no column has."""
    names = [meaning.name for meaning in result if meaning is not None and meaning.name]
    unknown = [name for name in choices.scales if name not in names]
    if unknown:
        raise RecordingError(
            f"scale: expected names of columns, {', '.join(names)}, got {', '.join(unknown)}"
            f"{did_you_mean(unknown, names)}"
        )


def _with_one_time(
    result: list[Meaning | None], placed: Mapping[int, Any], may_drop: bool
) -> list[Meaning | None]:
    """Leaves out further columns of times beside one that has a name. Those of a date and of a time
    of the day belong together, and both have titles of their own."""
    times = [place for place, meaning in enumerate(result) if meaning and meaning.kind == "time"]
    keep = [place for place in times if place in placed]
    if not may_drop or len(times) < 2 or (not keep and all(_has_date(result, p) for p in times)):
        return result
    numbers = [p for p in times if result[p].unit is not None]  # pyright: ignore
    keep = keep or numbers[:1] or times[:2]
    return [None if p in times and p not in keep else meaning for p, meaning in enumerate(result)]


def _has_date(result: Sequence[Meaning | None], place: int) -> bool:
    meaning = result[place]
    return meaning is not None and meaning.unit is None


def _by_place(
    titles: Sequence[str], choices: Choices, units: Sequence[str]
) -> list[tuple[int, str]]:
    """The places of the columns that have a name, and their names."""
    wholes = [f"{t} ({u})" if u else t for t, u in zip(titles, units, strict=True)] if units else []
    placed: list[tuple[int, str]] = []
    unknown = []
    for key, name in choices.columns.items():
        same = [place for place, title in enumerate(titles) if title == key]
        same = same or [place for place, whole in enumerate(wholes) if whole == key]
        if not same and str(key).isdigit() and 1 <= int(key) <= len(titles):
            same = [int(key) - 1]
        if len(same) > 1:
            raise RecordingError(
                f"columns: expected a title that occurs once, got {key!r} in the columns "
                f"{', '.join(str(place + 1) for place in same)}; name one by its number"
            )
        unknown += [] if same else [key]
        placed += [(place, name) for place in same]
    unknown += [
        pattern
        for pattern in choices.ignore
        if pattern != "*" and not any(fnmatchcase(title, pattern) for title in titles)
    ]
    if unknown:
        known = ", ".join(title for title in titles if title)
        raise RecordingError(
            f"columns: expected titles of the file, {known}, got {', '.join(map(str, unknown))}"
            f"{did_you_mean(list(map(str, unknown)), titles)}"
        )
    return placed
