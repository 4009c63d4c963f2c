"""The tables of a store of twins, for `jaxtwin` and for any program that reads SQLite.

Triggers refuse to change or delete a version and a move of an alias: what was once in use can
always be looked up.
"""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from .._twin_address import APPLICATION, FORMAT, check_store
from ..errors import StoreError

TABLES = """
CREATE TABLE versions (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    made TEXT NOT NULL,                             -- UTC, ISO 8601
    parent INTEGER REFERENCES versions (number),    -- the version that it was refitted from
    reason TEXT NOT NULL,
    rig TEXT NOT NULL,                              -- its name
    rig_text TEXT NOT NULL,                         -- the rig file
    fit TEXT NOT NULL,                              -- the saved fit, TOML
    posterior TEXT NOT NULL,                        -- JSON: labels, vector, covariance, between
    noise TEXT,                                     -- ProcessNoise, TOML
    recordings TEXT NOT NULL,                       -- JSON: name -> SHA-256 of the contents
    software TEXT NOT NULL                          -- JSON: name -> version
);
CREATE TABLE aliases (
    name TEXT PRIMARY KEY,
    version INTEGER NOT NULL REFERENCES versions (number)
);
CREATE TABLE moves (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    made TEXT NOT NULL,
    alias TEXT NOT NULL,
    before INTEGER REFERENCES versions (number),    -- NULL: the alias was new
    after INTEGER REFERENCES versions (number),     -- NULL: the alias was deleted
    reason TEXT NOT NULL
);
CREATE TABLE tags (
    version INTEGER NOT NULL REFERENCES versions (number),
    key TEXT NOT NULL,
    value TEXT NOT NULL,
    PRIMARY KEY (version, key)
);
"""

# The controllers of versions that are pairs. Stores of earlier versions of the package do not have
# this table, and those versions do not read it.
CONTROLLERS = """
CREATE TABLE controllers (
    version INTEGER PRIMARY KEY REFERENCES versions (number),
    controller TEXT NOT NULL,                       -- its file, TOML
    trial TEXT NOT NULL                             -- JSON: what `retune` found; an empty object
)
"""

# The tables whose rows stay as they are.
PERMANENT = ("versions", "moves")


def make_tables(connection: sqlite3.Connection, file: Path) -> None:
    """Makes the tables in an empty file, in one transaction, or checks that they are there. If two
    processes begin at the same time, the second finds those of the first.

    **Raises:** `StoreError` if the file is something else, or of a newer version of the package.
    """
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    if pages:
        check_store(connection, file, StoreError)
        return
    connection.execute("BEGIN IMMEDIATE")
    try:
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if not tables:
            for statement in [*TABLES.split(";\n"), *_triggers()]:
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {FORMAT}")
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise
    check_store(connection, file, StoreError)


def has_controllers(connection: sqlite3.Connection) -> bool:
    """Whether there is a table of controllers."""
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'controllers'"
    return connection.execute(query).fetchone() is not None


def make_controllers(connection: sqlite3.Connection) -> None:
    """Makes the table of controllers where there is none, in the transaction of the caller."""
    if not has_controllers(connection):
        for statement in [CONTROLLERS, *_triggers(("controllers",))]:
            connection.execute(statement)


def _triggers(tables: Sequence[str] = PERMANENT) -> list[str]:
    return [
        f"CREATE TRIGGER {table}_{action.lower()} BEFORE {action} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, 'rows of {table} are never changed'); END"
        for table in tables
        for action in ("UPDATE", "DELETE")
    ]
