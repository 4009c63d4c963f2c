"""Messages about unknown names that suggest the nearest known one."""

import difflib
from collections.abc import Iterable


def unknown_name(what: str, name: str, known: Iterable[str]) -> str:
    """A message about an unknown name: the kind of thing that it should name, a suggestion, and the
    known names."""
    names = list(known)
    hint = did_you_mean([name], names).replace(";", ",", 1) or "."
    return f"unknown {what} {name!r}{hint} Known: {', '.join(names) or 'none'}"


def did_you_mean(names: Iterable[str], known: Iterable[str]) -> str:
    """The end of a message about unknown names, `; did you mean 'a' and 'b'?`: the nearest known
    name of each, or nothing if there is none."""
    choices = list(known)
    near = [difflib.get_close_matches(name, choices, n=1) for name in names]
    result = list(dict.fromkeys(repr(first[0]) for first in near if first))
    return f"; did you mean {' and '.join(result)}?" if result else ""
