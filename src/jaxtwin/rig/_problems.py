"""Messages about mistakes in rig files: file, field, what was expected, what was found."""

import difflib
from collections.abc import Iterable
from typing import NoReturn

from .._errors import JaxtwinError, RigError


def refuse(source: str, field: str, message: str, error: type[JaxtwinError] = RigError) -> NoReturn:
    """Raises the error for a field of a file."""
    text = f"{field}: {message}" if field else message
    # Keys come from outside; a message is one line that any terminal shows.
    shown = "".join(c if c.isprintable() else "?" for c in text)
    raise error(f"{source}: {shown}") from None


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """A message about an unknown name that suggests the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f", did you mean {near[0]!r}?" if near else "."
    return f"unknown {what} {name!r}{hint} Known: {', '.join(names) or 'none'}"


def nearest(names: Iterable[str], known: Iterable[str]) -> str:
    """The end of a message about several unknown names: for each of them the nearest known one, or
    nothing."""
    choices = list(known)
    near = [difflib.get_close_matches(name, choices, n=1) for name in names]
    found = list(dict.fromkeys(repr(first[0]) for first in near if first))
    return f"; did you mean {' and '.join(found)}?" if found else ""


def label(item: object, index: int) -> str:
    """The label of a table of a list in messages: its name, or its position counted from 1."""
    if isinstance(item, dict):
        for key in ("name", "resistance"):
            if isinstance(item.get(key), str):
                return item[key]
    return str(index + 1)
