"""Twins in a store by an address such as `twins.db@champion`: which text it names.

`twin_store` writes these files. What reads parameter files must know their addresses, and stands
below that package.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, final

from ._name_suggestions import did_you_mean
from .errors import JaxtwinError

if TYPE_CHECKING:
    import sqlite3

# SQLite's `application_id` of a store, "jts1", which `file` and SQLite tools show.
APPLICATION = 0x6A747331

# The version of the tables.
FORMAT = 1

# How long a transaction waits for that of another process, s.
BUSY_SECONDS = 30.0

# What an alias may be; a version is a number.
ALIAS = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")

_ADDRESS = re.compile(rf"(.+\.db)@({ALIAS.pattern}|\d+)")


@final
class TwinAddress(NamedTuple):
    """Where a twin is: the file of its store, and the alias or the number of its version."""

    file: Path
    name: str


def twin_address(path: object) -> TwinAddress | None:
    """The address that a path is; None for the path of a file, and for anything else."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    result = _ADDRESS.fullmatch(text) if isinstance(text, str) else None
    if result is None or Path(result[0]).exists():
        return None
    return TwinAddress(Path(result[1]).expanduser(), result[2])


def read_stored_fit(address: TwinAddress, error: type[JaxtwinError]) -> bytes:
    """The text of the fit at an address, as `Fit.save` would have written it.

    **Raises:** `error` if the file is no store, or has no such version.
    """
    with opened_store(address.file, error) as connection:
        number = version_number(connection, address.file, address.name, error)
        (text,) = connection.execute(
            "SELECT fit FROM versions WHERE number = ?", (number,)
        ).fetchone()
        return text.encode()


@contextmanager
def opened_store(file: Path, error: type[JaxtwinError]) -> "Iterator[sqlite3.Connection]":
    """An existing store, which is closed when the block ends. Transactions begin where they are
    written down.

    **Raises:** `error` if the file is missing, no store, damaged, or of a newer version of the
    package; also for errors of SQLite inside the block.
    """
    if not file.is_file():
        raise error(f"{file}: expected a store of twins, got no such file")
    with connected(file, error) as connection:
        check_store(connection, file, error)
        yield connection


@contextmanager
def connected(file: Path, error: type[JaxtwinError]) -> "Iterator[sqlite3.Connection]":
    """A connection whose errors name the file; SQLite makes an empty file where there is none.

    **Raises:** `error` for errors of SQLite inside the block.
    """
    import sqlite3  # which every twin would load at the top

    connection = None
    try:
        # The journal of a killed process is rolled back by the next one that opens the file.
        connection = sqlite3.connect(file, timeout=BUSY_SECONDS, isolation_level=None)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        yield connection
    except sqlite3.Error as problem:
        raise error(f"{file}: store of twins: {problem}") from None
    finally:
        if connection is not None:
            connection.close()


def check_store(connection: "sqlite3.Connection", file: Path, error: type[JaxtwinError]) -> None:
    """Refuses what is no store, and a store of a newer version of the package.

    **Raises:** `error` that names the file.
    """
    (kind,) = connection.execute("PRAGMA application_id").fetchone()
    (form,) = connection.execute("PRAGMA user_version").fetchone()
    if kind != APPLICATION:
        raise error(f"{file}: expected a store of twins, got another file; name another")
    if form > FORMAT:
        raise error(
            f"{file}: expected a store of format {FORMAT}, got format {form} of a newer jaxtwin; "
            "update jaxtwin"
        )


def version_number(
    connection: "sqlite3.Connection", file: Path, name: str | int, error: type[JaxtwinError]
) -> int:
    """The number of a version, by itself or by an alias.

    **Raises:** `error` if there is none.
    """
    if isinstance(name, int) or name.isdecimal():
        number = int(name)
        # SQLite's integers end there.
        if (
            number < 2**63
            and connection.execute("SELECT 1 FROM versions WHERE number = ?", (number,)).fetchone()
        ):
            return number
        (count,) = connection.execute("SELECT count(*) FROM versions").fetchone()
        raise error(f"{file}: version: expected 1 to {count}, got {name}")
    rows = dict(connection.execute("SELECT name, version FROM aliases ORDER BY name").fetchall())
    if name not in rows:
        raise error(
            f"{file}: alias: expected one of {', '.join(rows) or '(none)'}, got {name!r}"
            f"{did_you_mean([name], rows)}"
        )
    return rows[name]
