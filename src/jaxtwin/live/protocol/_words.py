"""Numbers, words and names in a line of the protocol, each checked against its bounds."""

import re
from collections.abc import Sequence
from urllib.parse import quote, unquote_to_bytes

from ..._celsius import ZERO_CELSIUS
from ._messages import MAX_NAMES

# The largest number of characters of a name, before it is encoded.
MAX_NAME = 32

_WORD = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_QUOTED = re.compile(r"(?:[A-Za-z0-9_.-]|%[0-9A-F]{2})+")
# Without leading zeros, because some readers take `010` for eight. C prints `-0.00` just below 0.
_INTEGER = re.compile(r"0|-?[1-9][0-9]{0,18}")
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,5})(\.[0-9]{1,6})?")


def read_integer(text: str, least: int, most: int) -> int:
    """A whole number. **Raises:** `ValueError` if it is none or out of its bounds."""
    # `int` by itself would accept blanks, underscores and any length.
    if not _INTEGER.fullmatch(text) or not least <= int(text) <= most:
        raise ValueError(f"expected a whole number from {least} to {most}, got {text[:24]!r}")
    return int(text)


def read_number(text: str, least: float = -ZERO_CELSIUS, most: float = 2000.0) -> float:
    """A number in plain digits. **Raises:** `ValueError` if it is none or out of its bounds."""
    if not _NUMBER.fullmatch(text) or not least <= float(text) <= most:
        raise ValueError(f"expected a number from {least:g} to {most:g}, got {text[:24]!r}")
    return float(text)


def read_word(text: str) -> str:
    """Reads a word that a device chooses, such as a kind, a boot or an owner.

    **Raises:** `ValueError` if it is none.
    """
    if not _WORD.fullmatch(text):
        raise ValueError(f"expected 1 to 32 of A-Z a-z 0-9 _ . -, got {text[:40]!r}")
    return text


def write_name(name: str) -> str:
    """A name of a rig, cell or channel, percent-encoded as in URLs for a line."""
    return quote(name, safe="").replace("~", "%7E")


def read_name(text: str) -> str:
    """Reads a name that `write_name` has written.

    **Raises:** `ValueError` if it is none, or written in another way than `write_name` does.
    """
    problem = f"name: expected 1 to {MAX_NAME} characters, quoted by %, got {text[:40]!r}"
    if not _QUOTED.fullmatch(text):
        raise ValueError(problem)
    try:
        name = unquote_to_bytes(text).decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError(problem) from None
    if len(name) > MAX_NAME or not name.isprintable() or write_name(name) != text:
        raise ValueError(problem)
    return name


def read_names(text: str) -> tuple[str, ...]:
    """Reads names that are separated by commas. No name may occur twice."""
    names = tuple(read_name(part) for part in split(text))
    if len(set(names)) < len(names):
        raise ValueError(f"expected at most {MAX_NAMES} names, each once, got {len(names)}")
    return names


def split(text: str) -> Sequence[str]:
    """Returns the parts between commas; an empty text has no parts."""
    parts = text.split(",") if text else []
    if len(parts) > MAX_NAMES:
        raise ValueError(f"expected at most {MAX_NAMES} entries, got {len(parts)}")
    return parts
