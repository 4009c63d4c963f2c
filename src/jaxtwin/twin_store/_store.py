"""The store of twins: one SQLite file."""

import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any, final

import numpy as np

from .. import __version__
from .._arguments import mapping_of, of_kind, path_of
from .._name_suggestions import did_you_mean
from .._twin_address import ALIAS, connected, opened_store, version_number
from ..errors import StoreError
from ..io import Experiment
from ..matching import Fit, fit_text, solution_of
from ..observers import ProcessNoise
from ..rig import parse_toml
from ._schema import has_controllers, make_controllers, make_tables
from ._version import AliasMove, TwinVersion, VersionDiff, diff_versions

CHAMPION, CHALLENGER, PREVIOUS = "champion", "challenger", "previous"
"""The aliases of the twin in use, of one that waits for a decision, and of the champion before."""

_COLUMNS = "number, made, parent, reason, rig, recordings, software, fit, rig_text, noise"


@final
class TwinStore:
    """A memory of twins in one SQLite file, which is made where there is none.

    Versions never change; aliases and tags do. Every change is one transaction: a kill or a full
    disk leaves all of it or nothing, and several processes may use a store at the same time.

    ```python
    store = jaxtwin.TwinStore("twins.db")
    store.add(fit, reason="first match", aliases=["champion"])
    twin = jaxtwin.Twin("twins.db@champion")
    ```

    **Arguments:**

    - `path`: the file, .db.

    **Raises:** `StoreError` if the file is something else, was made by a newer version of the
    package, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = path_of("TwinStore: path", path, StoreError)
        if self.path.suffix != ".db":
            raise StoreError(f"{self.path}: ending: expected .db, got {self.path.suffix!r}")
        if not self.path.parent.is_dir():
            raise StoreError(f"{self.path}: there is no folder {self.path.parent}")
        with connected(self.path, StoreError) as connection:
            make_tables(connection, self.path)

    def add(
        self,
        fit: Fit,
        *,
        reason: str,
        parent: str | int | None = None,
        noise: ProcessNoise | None = None,
        aliases: Sequence[str] = (),
        tags: Mapping[str, str] | None = None,
        controller: str | None = None,
        trial: Mapping[str, Any] | None = None,
    ) -> TwinVersion:
        """Adds a version.

        **Arguments:**

        - `fit`: the fit.
        - `reason`: why it was made, a sentence.
        - `parent`: the alias or number of the version that it was refitted from.
        - `noise`: the noise of its observer.
        - `aliases`: aliases that move to it, in the same transaction.
        - `tags`: name -> text.
        - `controller`: the text of the file of the controller that belongs to the twin.
        - `trial`: what `jaxtwin.retune` found of that controller, as its `to_dict` gives it.

        **Returns:** the version.

        **Raises:** `StoreError` for a fit of another rig than the others, a rig that is not as its
        file says, and a name that is no alias.
        """
        of_kind("TwinStore.add: fit", fit, Fit, "a Fit, as match gives it", StoreError)
        reason = _sentence("add: reason", reason)
        names = [self._alias(name) for name in aliases]
        given = _texts("add: tags", tags)
        text = fit_text(fit, str(self.path))
        table = parse_toml(text.encode(), str(self.path), StoreError)["fit"]
        if "rig_text" not in table:
            raise StoreError(
                f"{self.path}: expected a fit of a rig that is as its file says, got one of "
                f"{fit.twin.rig.name!r} ({fit.twin.rig.source}), which was changed after it was "
                "read; write that rig to a file and match again"
            )
        if noise is not None:
            of_kind("TwinStore.add: noise", noise, ProcessNoise, "a ProcessNoise", StoreError)
        made = _now()
        with self._transaction() as connection:
            self._check_rig(connection, fit.twin.rig.name)
            before = None if parent is None else self._number(connection, parent)
            number = connection.execute(
                "INSERT INTO versions (made, parent, reason, rig, rig_text, fit, posterior, noise, "
                "recordings, software) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    made,
                    before,
                    reason,
                    fit.twin.rig.name,
                    table["rig_text"],
                    text,
                    json.dumps(_posterior(fit)),
                    None if noise is None else noise.to_toml(),
                    json.dumps(dict(zip(fit.recordings, fit.fingerprints, strict=True))),
                    json.dumps({**fit.versions, "stored by jaxtwin": __version__}),
                ),
            ).lastrowid
            assert number is not None
            if controller is not None:
                make_controllers(connection)
                row = number, controller, json.dumps(dict(trial or {}))
                connection.execute("INSERT INTO controllers VALUES (?, ?, ?)", row)
            for name in names:
                _move(connection, made, name, number, reason)
            for key, value in given.items():
                connection.execute("INSERT INTO tags VALUES (?, ?, ?)", (number, key, value))
        return self.version(number)

    @property
    def versions(self) -> tuple[TwinVersion, ...]:
        """All versions, in the order in which they were added."""
        with self._reading() as connection:
            rows = connection.execute(f"SELECT {_COLUMNS} FROM versions ORDER BY number").fetchall()
            return tuple(self._version(connection, row) for row in rows)

    @property
    def aliases(self) -> dict[str, int]:
        """Alias -> number of its version."""
        with self._reading() as connection:
            return dict(connection.execute("SELECT name, version FROM aliases ORDER BY name"))

    def version(self, name: str | int) -> TwinVersion:
        """Returns a version.

        **Arguments:**

        - `name`: an alias, or the number of a version.

        **Raises:** `StoreError` if there is none.
        """
        with self._reading() as connection:
            number = self._number(connection, name)
            query = f"SELECT {_COLUMNS} FROM versions WHERE number = ?"
            return self._version(connection, connection.execute(query, (number,)).fetchone())

    def fit(
        self, name: str | int, experiments: Experiment | Sequence[Experiment] | None = None
    ) -> Fit:
        """Returns the fit of a version: `store.version(name).fit(experiments)`."""
        return self.version(name).fit(experiments)

    def set_alias(self, alias: str, version: str | int, *, reason: str) -> None:
        """Moves an alias to a version, or makes it.

        **Raises:** `StoreError` if there is no such version, or the name is no alias.
        """
        name, why = self._alias(alias), _sentence("set_alias: reason", reason)
        with self._transaction() as connection:
            _move(connection, _now(), name, self._number(connection, version), why)

    def delete_alias(self, alias: str, *, reason: str) -> None:
        """Deletes an alias. Its version stays.

        **Raises:** `StoreError` if there is none of this name.
        """
        name, why = self._alias(alias), _sentence("delete_alias: reason", reason)
        with self._transaction() as connection:
            self._number(connection, name)
            _move(connection, _now(), name, None, why)

    def promote(self, version: str | int = CHALLENGER, *, reason: str) -> TwinVersion:
        """Makes a version the champion, in one transaction. The champion so far is `previous` from
        then on, and an alias `challenger` of the promoted version is deleted.

        **Arguments:**

        - `version`: its alias or number.
        - `reason`: why, a sentence.

        **Returns:** the champion. Nothing moves if the version is the champion already.

        **Raises:** `StoreError` if there is no such version.
        """
        why = _sentence("promote: reason", reason)
        with self._transaction() as connection:
            number = self._number(connection, version)
            known = dict(connection.execute("SELECT name, version FROM aliases"))
            made, before = _now(), known.get(CHAMPION)
            if before != number:
                if before is not None:
                    _move(connection, made, PREVIOUS, before, why)
                _move(connection, made, CHAMPION, number, why)
            if known.get(CHALLENGER) == number:
                _move(connection, made, CHALLENGER, None, why)
        return self.version(number)

    def rollback(self, *, reason: str) -> TwinVersion:
        """Makes `previous` the champion again, and the champion `previous`: a second rollback takes
        the first one back.

        **Returns:** the champion.

        **Raises:** `StoreError` if there is no previous champion.
        """
        return self.promote(PREVIOUS, reason=reason)

    def history(self, alias: str | None = None) -> tuple[AliasMove, ...]:
        """Returns the moves of an alias, or of all, the first one first."""
        query = "SELECT made, alias, before, after, reason FROM moves"
        with self._reading() as connection:
            if alias is None:
                rows = connection.execute(f"{query} ORDER BY number").fetchall()
            else:
                query += " WHERE alias = ? ORDER BY number"
                rows = connection.execute(query, (self._alias(alias),)).fetchall()
        return tuple(AliasMove(*row) for row in rows)

    def diff(self, old: str | int, new: str | int) -> VersionDiff:
        """Returns the difference of two versions: parameters, recordings, rig file, software.

        **Raises:** `StoreError` if one of them is missing.
        """
        return diff_versions(self.version(old), self.version(new))

    def set_tag(self, version: str | int, key: str, value: str) -> None:
        """Sets a tag of a version.

        **Raises:** `StoreError` if there is no such version.
        """
        _texts("set_tag", {key: value})
        with self._transaction() as connection:
            number = self._number(connection, version)
            query = "INSERT OR REPLACE INTO tags VALUES (?, ?, ?)"
            connection.execute(query, (number, key, value))

    def delete_tag(self, version: str | int, key: str) -> None:
        """Deletes a tag of a version.

        **Raises:** `StoreError` if there is no such version or tag.
        """
        with self._transaction() as connection:
            number = self._number(connection, version)
            rows = connection.execute("SELECT key FROM tags WHERE version = ?", (number,))
            keys = [row[0] for row in rows]
            if key not in keys:
                raise StoreError(
                    f"{self.path}: version {number}: tag: expected one of "
                    f"{', '.join(keys) or '(none)'}, got {key!r}{did_you_mean([key], keys)}"
                )
            connection.execute("DELETE FROM tags WHERE version = ? AND key = ?", (number, key))

    def summary(self) -> str:
        """A line for each version, with its aliases."""
        lines = []
        for version in self.versions:
            names = f" [{', '.join(version.aliases)}]" if version.aliases else ""
            parent = "" if version.parent is None else f" from {version.parent}"
            lines.append(f"{version.number}{parent}  {version.made}{names}  {version.reason}")
        return "\n".join(lines) or "no version yet"

    def __repr__(self) -> str:
        return f"<TwinStore {self.path}: {len(self.versions)} versions, {self.aliases}>"

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """A connection whose queries all see the same state."""
        with opened_store(self.path, StoreError) as connection:
            connection.execute("BEGIN")
            yield connection

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """A connection in a transaction, which an error takes back."""
        with opened_store(self.path, StoreError) as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                yield connection
                connection.execute("COMMIT")
            except BaseException:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                raise

    def _number(self, connection: sqlite3.Connection, name: str | int) -> int:
        if isinstance(name, bool) or not isinstance(name, str | int):
            raise StoreError(
                f"{self.path}: version: expected an alias or the number of a version, got {name!r}"
            )
        return version_number(connection, self.path, name, StoreError)

    def _alias(self, name: object) -> str:
        if not isinstance(name, str) or not ALIAS.fullmatch(name):
            raise StoreError(
                f"{self.path}: alias: expected a name such as 'champion', of letters, digits, '.', "
                f"'_' and '-' that begins with a letter, got {name!r}"
            )
        return name

    def _check_rig(self, connection: sqlite3.Connection, name: str) -> None:
        row = connection.execute("SELECT rig FROM versions LIMIT 1").fetchone()
        if row is not None and row[0] != name:
            raise StoreError(
                f"{self.path}: expected a twin of {row[0]!r}, as the others are, got one of "
                f"{name!r}; a rig has a store of its own"
            )

    def _version(self, connection: sqlite3.Connection, row: Sequence[Any]) -> TwinVersion:
        number, made, parent, reason, rig, recordings, software, fit, rig_text, noise = row
        names = connection.execute(
            "SELECT name FROM aliases WHERE version = ? ORDER BY name", (number,)
        )
        query = "SELECT key, value FROM tags WHERE version = ? ORDER BY key"
        pair = None
        if has_controllers(connection):
            query_pair = "SELECT controller, trial FROM controllers WHERE version = ?"
            pair = connection.execute(query_pair, (number,)).fetchone()
        return TwinVersion(
            store=str(self.path),
            number=number,
            made=made,
            parent=parent,
            reason=reason,
            rig=rig,
            recordings=json.loads(recordings),
            software=json.loads(software),
            aliases=tuple(name[0] for name in names),
            tags=dict(connection.execute(query, (number,)).fetchall()),
            fit_text=fit,
            rig_text=rig_text,
            noise_text=noise,
            controller_text=None if pair is None else pair[0],
            trial={} if pair is None else json.loads(pair[1]),
        )


def _move(
    connection: sqlite3.Connection, made: str, alias: str, after: int | None, reason: str
) -> None:
    row = connection.execute("SELECT version FROM aliases WHERE name = ?", (alias,)).fetchone()
    before = None if row is None else row[0]
    if before == after:
        return
    if after is None:
        connection.execute("DELETE FROM aliases WHERE name = ?", (alias,))
    else:
        connection.execute("INSERT OR REPLACE INTO aliases VALUES (?, ?)", (alias, after))
    connection.execute(
        "INSERT INTO moves (made, alias, before, after, reason) VALUES (?, ?, ?, ?, ?)",
        (made, alias, before, after, reason),
    )


def _posterior(fit: Fit) -> dict[str, Any]:
    """The posterior of the vector, in which positive parameters are logarithms; JSON has no NaN."""
    known = fit.uncertainty

    def plain(array: Any) -> Any:
        result = np.array(array, object)
        result[~np.isfinite(array)] = None
        return result.tolist()

    return {
        "labels": list(known.labels),
        "vector": plain(solution_of(fit).vector),
        "covariance": plain(known.vector_covariance),
        "between_recordings": plain(known.between_recordings),
    }


def _sentence(where: str, text: object) -> str:
    if not isinstance(text, str) or not text.strip():
        raise StoreError(f"TwinStore.{where}: expected a sentence, got {text!r}")
    return " ".join(text.split())


def _texts(where: str, tags: Mapping[str, str] | None) -> dict[str, str]:
    result = dict(mapping_of(f"TwinStore.{where}", tags or {}, "name -> text", StoreError))
    for key, value in result.items():
        if not isinstance(value, str):
            raise StoreError(f"TwinStore.{where}: {key}: expected text, got {value!r}")
    return result


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
