"""Messages about errors in rig files: the file, the field, the expected and the actual value."""

from typing import NoReturn

from ..errors import JaxtwinError, RigError


def refuse(source: str, field: str, message: str, error: type[JaxtwinError] = RigError) -> NoReturn:
    """Raises the error for a field of a file."""
    text = f"{field}: {message}" if field else message
    # Keys come from a file and may contain anything; the message must be one printable line.
    shown = "".join(c if c.isprintable() else "?" for c in text)
    raise error(f"{source}: {shown}") from None


def label(item: object, index: int) -> str:
    """The label of a table of a list in messages: its name, or its position counted from 1."""
    if isinstance(item, dict):
        for key in ("name", "resistance"):
            if isinstance(item.get(key), str):
                return item[key]
    return str(index + 1)
