"""Files in TOML: those that come with the package, reading, and messages about errors that name the
file, the field, the expected and the actual value.
"""

import os
import tomllib
from typing import Any, NoReturn

from .._arguments import path_of
from .._data_folder import data_folder
from .._name_suggestions import unknown_name
from .._twin_address import read_stored_fit, twin_address
from ..errors import JaxtwinError, RigError


def bundled_rigs() -> tuple[str, ...]:
    """The names of the rigs that come with the package."""
    return _names("rigs")


def bundled_modules() -> tuple[str, ...]:
    """The names of the thermoelectric modules whose datasheets come with the package."""
    return _names("modules")


def bundled_materials() -> tuple[str, ...]:
    """The names of the materials that come with the package."""
    return _names("materials")


def read_bundled(folder: str, name: str) -> tuple[dict[str, Any], str]:
    """Returns a bundled file and its name in messages.

    **Raises:** `RigError` if there is no file of that name.
    """
    content, source = bundled_content(folder, name)
    return parse_toml(content, source), source


def bundled_content(folder: str, name: str) -> tuple[bytes, str]:
    """Returns the content of a bundled file, and its name in messages.

    **Raises:** `RigError` if there is no file of that name.
    """
    if name not in _names(folder):
        refuse(name, "", unknown_name(f"name of the bundled {folder}", name, _names(folder)))
    return (data_folder() / folder / f"{name}.toml").read_bytes(), f"{name}.toml (bundled)"


def read_toml(
    path: str | os.PathLike[str], error: type[JaxtwinError] = RigError
) -> tuple[dict[str, Any], str]:
    """Reads a TOML file. Returns its tables and its name in messages.

    **Raises:** the error if it cannot be read or is not TOML.
    """
    content, source = file_content(path, error)
    return parse_toml(content, source, error), source


def file_content(
    path: str | os.PathLike[str], error: type[JaxtwinError] = RigError
) -> tuple[bytes, str]:
    """Returns the content of a TOML file, or of a fit in a store of twins (`twins.db@champion`),
    and its name in messages.

    **Raises:** the error if it cannot be read.
    """
    address = twin_address(path)
    if address is not None:
        return read_stored_fit(address, error), os.fspath(path)
    place = path_of("path", path, error)
    source = os.fspath(place)
    try:
        return place.read_bytes(), source
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        refuse(source, "", f"expected a TOML file, which cannot be read: {reason}", error)


def parse_toml(content: bytes, source: str, error: type[JaxtwinError] = RigError) -> dict[str, Any]:
    """The tables of a TOML document.

    **Raises:** the error, naming line and column, if it is not TOML.
    """
    try:
        # Editors on Windows put a byte order mark before the text.
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as problem:
        line = content[: problem.start].count(b"\n") + 1
        refuse(
            source,
            f"line {line}",
            "expected TOML in UTF-8, got another encoding; save the file as UTF-8",
            error,
        )
    except tomllib.TOMLDecodeError as problem:
        lines = content.count(b"\n") + 1
        where = str(problem).replace("at end of document", f"at line {lines}, the last one")
        refuse(source, "", f"no valid TOML: {where}", error)
    except RecursionError:
        refuse(source, "", "no valid TOML: nested too deeply", error)


def _names(folder: str) -> tuple[str, ...]:
    return tuple(sorted(file.stem for file in (data_folder() / folder).glob("*.toml")))


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
