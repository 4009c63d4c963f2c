"""The store of twins: what it keeps, how aliases move, and what it survives."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from small_results import fit

import jaxtwin as jt
from jaxtwin._twin_address import BUSY_SECONDS, FORMAT, twin_address
from jaxtwin.twin_store import _store


@pytest.fixture
def store(tmp_path: Path) -> jt.TwinStore:
    return jt.TwinStore(tmp_path / "twins.db")


@pytest.fixture
def two(store: jt.TwinStore) -> jt.TwinStore:
    """Two versions, the second a refit of the first that waits."""
    store.add(fit(), reason="first match", aliases=["champion"])
    store.add(fit(), reason="refit", parent="champion", aliases=["challenger"])
    return store


def refused(statement: str, file: Path) -> str:
    connection = sqlite3.connect(file)
    try:
        with pytest.raises(sqlite3.IntegrityError) as problem:
            connection.execute(statement)
        return str(problem.value)
    finally:
        connection.close()


def test_a_version_holds_what_was_added(store: jt.TwinStore):
    noise = jt.ProcessNoise(heat=0.7, names=("R_E",))
    added = store.add(fit(), reason="first  match\n", noise=noise, tags={"by": "night"})
    assert added == store.version(1)
    assert (added.number, added.parent, added.reason) == (1, None, "first match")
    assert added.recordings == dict(zip(fit().recordings, fit().fingerprints, strict=True))
    assert added.tags == {"by": "night"}
    assert added.software["jaxtwin"] == jt.__version__
    assert added.rig_text == fit().twin.rig.text
    assert added.noise is not None
    assert added.noise.levels() == noise.levels()
    assert added.noise.names == ("R_E",)
    loaded = added.fit()
    assert loaded.twin.values == fit().twin.values
    np.testing.assert_array_equal(
        loaded.uncertainty.vector_covariance, fit().uncertainty.vector_covariance
    )


def test_the_posterior_is_readable_by_other_programs(two: jt.TwinStore):
    """As JSON in plain SQLite, without jaxtwin."""
    connection = sqlite3.connect(two.path)
    (text,) = connection.execute("SELECT posterior FROM versions WHERE number = 2").fetchone()
    connection.close()
    found = json.loads(text)
    assert found["labels"] == list(fit().uncertainty.labels)
    known = np.array(found["covariance"], float)  # null where a value was held at a bound
    np.testing.assert_array_equal(known, fit().uncertainty.vector_covariance)


def test_a_written_fit_is_the_file_that_save_writes(two: jt.TwinStore, tmp_path: Path):
    fit().save(tmp_path / "saved.toml")
    assert two.version(1).fit_text == (tmp_path / "saved.toml").read_text(encoding="utf-8")
    two.version(1).write(tmp_path / "written.toml")
    assert jt.Fit.load(tmp_path / "written.toml").twin.values == fit().twin.values


def test_promotion_moves_three_aliases_and_rollback_takes_it_back(two: jt.TwinStore):
    two.promote(reason="it predicts better")
    assert two.aliases == {"champion": 2, "previous": 1}
    assert two.rollback(reason="the loop swings").number == 1
    assert two.aliases == {"champion": 1, "previous": 2}
    two.rollback(reason="it was the cable")
    assert two.aliases == {"champion": 2, "previous": 1}
    moves = [(one.before, one.after, one.reason) for one in two.history("champion")]
    assert moves == [
        (None, 1, "first match"),
        (1, 2, "it predicts better"),
        (2, 1, "the loop swings"),
        (1, 2, "it was the cable"),
    ]
    assert two.history("challenger")[-1].after is None
    two.promote(2, reason="again")
    assert len(two.history("champion")) == 4


def test_aliases_and_tags_are_set_and_deleted(two: jt.TwinStore):
    two.set_alias("winter", 1, reason="the lab is cold")
    two.set_tag("winter", "room", "15 degC")
    two.set_tag("winter", "room", "14 degC")
    assert two.version("winter").tags == {"room": "14 degC"}
    assert two.version("winter").aliases == ("champion", "winter")
    two.delete_tag(1, "room")
    two.delete_alias("winter", reason="spring")
    assert two.version(1).tags == {}
    assert "winter" not in two.aliases
    with pytest.raises(jt.errors.StoreError, match=r"one of challenger, champion, got 'winter'"):
        two.version("winter")
    with pytest.raises(jt.errors.StoreError, match=r"tag: expected one of \(none\), got 'room'"):
        two.delete_tag(1, "room")


def test_what_was_once_in_use_cannot_be_changed(two: jt.TwinStore):
    """Not by another program either."""
    assert "never changed" in refused("UPDATE versions SET reason = 'x'", two.path)
    assert "never changed" in refused("DELETE FROM versions", two.path)
    assert "never changed" in refused("UPDATE moves SET reason = 'x'", two.path)
    assert "never changed" in refused("DELETE FROM moves", two.path)


def test_an_address_stands_for_the_file_of_a_fit(two: jt.TwinStore):
    address = f"{two.path}@champion"
    for twin in (
        jt.Twin(address),
        jt.Twin(Path(address)),
        jt.Twin("paper-2024", address),
        jt.Twin("paper-2024").with_values(f"{two.path}@2"),
        jt.Fit.load(address).twin,
    ):
        assert twin.values["R_E"] == fit().twin.values["R_E"]
    assert jt.Twin(address).rig == fit().twin.rig
    assert jt.read_parameters(address, fit().twin.rig)["R_pc"] == fit().twin.values["R_pc"]
    assert jt.Twin(address, {"R_E": 2.0}).values["R_E"] == 2.0


def test_a_file_whose_name_is_like_an_address_is_that_file(two: jt.TwinStore):
    file = Path(f"{two.path}@champion")
    fit().save(file.with_name("fit.toml"))
    file.with_name("fit.toml").rename(file)
    assert twin_address(file) is None
    assert jt.Fit.load(file).twin.values == fit().twin.values


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("champoin", r"one of challenger, champion, got 'champoin'; did you mean 'champion'"),
        ("3", "version: expected 1 to 2, got 3"),
        ("99999999999999999999", "version: expected 1 to 2"),
    ],
)
def test_a_missing_version_is_named(two: jt.TwinStore, name: str, message: str):
    for read in (jt.Fit.load, jt.Twin):
        with pytest.raises(jt.JaxtwinError, match=message):
            read(f"{two.path}@{name}")


def test_an_address_is_no_rig(two: jt.TwinStore):
    with pytest.raises(jt.errors.RigError, match="expected a rig, got a twin of a store"):
        jt.load_rig(f"{two.path}@champion")


def test_a_store_of_a_newer_version_is_refused_in_a_sentence_that_names_it(two: jt.TwinStore):
    connection = sqlite3.connect(two.path)
    connection.execute(f"PRAGMA user_version = {FORMAT + 1}")
    connection.close()
    for use in (lambda: jt.TwinStore(two.path), lambda: jt.Twin(f"{two.path}@champion")):
        with pytest.raises(jt.JaxtwinError) as problem:
            use()
        text = str(problem.value)
        assert text.startswith(f"{two.path}: expected a store of format {FORMAT}, got format")
        assert "\n" not in text


def test_another_file_is_left_alone(tmp_path: Path):
    text = tmp_path / "notes.db"
    text.write_text("no database, but a file of a person")
    other = tmp_path / "other.db"
    connection = sqlite3.connect(other)
    connection.execute("CREATE TABLE own (number)")
    connection.close()
    before = [file.read_bytes() for file in (text, other)]
    with pytest.raises(
        jt.errors.StoreError, match=r"notes\.db: store of twins: file is not a database"
    ):
        jt.TwinStore(text)
    with pytest.raises(
        jt.errors.StoreError, match=r"other\.db: expected a store of twins, got another"
    ):
        jt.TwinStore(other)
    assert [file.read_bytes() for file in (text, other)] == before
    with pytest.raises(jt.JaxtwinError, match=r"none\.db: expected a store of twins, got no such"):
        jt.Twin(f"{tmp_path / 'none.db'}@champion")
    with pytest.raises(jt.errors.StoreError, match=r"expected \.db, got '\.toml'"):
        jt.TwinStore(tmp_path / "twins.toml")


def test_a_store_has_twins_of_one_rig(two: jt.TwinStore):
    connection = sqlite3.connect(two.path)
    connection.execute("DROP TRIGGER versions_update")
    connection.execute("UPDATE versions SET rig = 'other'")
    connection.commit()
    connection.close()
    with pytest.raises(
        jt.errors.StoreError, match="twin of 'other', as the others are, got one of"
    ):
        two.add(fit(), reason="another rig")


def test_the_difference_of_two_versions_names_what_differs(store: jt.TwinStore):
    store.add(fit(), reason="first match")
    rig = fit().twin.rig
    store.add(fit(), reason="refit", parent=1)
    found = store.diff(1, 2)
    assert found.summary().splitlines() == ["version 1 to version 2: refit", "no difference"]
    assert found.to_dict()["recordings_only_new"] == []
    assert rig.text == store.version(2).rig_text


def test_a_full_disk_leaves_what_was_there(two: jt.TwinStore, monkeypatch: pytest.MonkeyPatch):
    """SQLite refuses to grow a file beyond its pages as it does on a full disk."""
    opened = _store.opened_store

    def full(file, error):
        context = opened(file, error)
        connection = context.__enter__()
        connection.execute("PRAGMA max_page_count = 1")  # raised to what the file has
        return _Same(context, connection)

    monkeypatch.setattr(_store, "opened_store", full)
    with pytest.raises(jt.errors.StoreError, match=r"twins\.db: store of twins: .*full"):
        two.add(fit(), reason="too much", aliases=["champion"])
    monkeypatch.undo()
    assert [one.number for one in two.versions] == [1, 2]
    assert two.aliases == {"champion": 1, "challenger": 2}
    assert two.add(fit(), reason="space again").number == 3


class _Same:
    """An open context."""

    def __init__(self, context, connection):
        self.context, self.connection = context, connection

    def __enter__(self):
        return self.connection

    def __exit__(self, *problem):
        return self.context.__exit__(*problem)


def test_an_error_in_a_transaction_takes_all_of_it_back(two: jt.TwinStore):
    with pytest.raises(jt.errors.StoreError, match="alias: expected one of"):
        two.add(fit(), reason="refit", parent="nobody", aliases=["champion"])
    with pytest.raises(jt.errors.StoreError, match="begins with a letter, got '7'"):
        two.add(fit(), reason="refit", aliases=["7"])
    assert len(two.versions) == 2
    assert two.aliases == {"champion": 1, "challenger": 2}


def test_many_writers_lose_nothing(store: jt.TwinStore):
    assert BUSY_SECONDS >= 30
    with ThreadPoolExecutor(8) as pool:
        numbers = list(pool.map(lambda n: store.add(fit(), reason=f"{n}").number, range(16)))
    assert sorted(numbers) == list(range(1, 17))
    reasons = {one.number: one.reason for one in store.versions}
    assert {reasons[number] for number in numbers} == {str(n) for n in range(16)}


WRITER = """
import itertools, sys
import jaxtwin as jt
fit, store = jt.Fit.load(sys.argv[2]), jt.TwinStore(sys.argv[1])
for count in itertools.count():
    added = store.add(fit, reason=sys.argv[3] + f" {count}", aliases=["champion", "other"])
    print(added.number, flush=True)
"""


@pytest.mark.slow
def test_two_processes_write_and_one_is_killed(tmp_path: Path):
    """`kill -9` in the middle of its writing: every version that was reported is there, the store
    is whole, both aliases of the last version moved together, and the other process goes on."""
    fit().save(tmp_path / "fit.toml")
    file = tmp_path / "twins.db"
    reported: dict[str, list[int]] = {}
    processes = {}
    for name in ("killed", "other"):
        processes[name] = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(file), str(tmp_path / "fit.toml"), name],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ,
        )
    for name, count in (("killed", 5), ("other", 5)):
        stream = processes[name].stdout
        assert stream is not None
        reported[name] = [int(stream.readline()) for _ in range(count)]
        if name == "killed":
            os.kill(processes[name].pid, signal.SIGKILL)
            rest = stream.read().split()
            reported[name] += [int(number) for number in rest]
    stream = processes["other"].stdout
    assert stream is not None
    reported["other"] += [int(stream.readline()) for _ in range(5)]
    os.kill(processes["other"].pid, signal.SIGKILL)
    reported["other"] += [int(number) for number in stream.read().split()]
    for process in processes.values():
        process.communicate()
    store = jt.TwinStore(file)
    connection = sqlite3.connect(file)
    assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
    connection.close()
    reasons = {one.number: one.reason for one in store.versions}
    for name, numbers in reported.items():
        assert [reasons[number] for number in numbers] == [
            f"{name} {n}" for n in range(len(numbers))
        ]
    assert store.aliases["champion"] == store.aliases["other"] == max(reasons)
    assert all(one.fit_text == store.versions[0].fit_text for one in store.versions)
    assert store.add(fit(), reason="after").number == max(reasons) + 1


def test_a_pair_keeps_its_controller_and_its_trial(two: jt.TwinStore):
    trial = {"decision": "accepted", "scenarios": [{"name": "steps"}]}
    three = two.add(
        fit(), reason="retuned", parent="champion", controller="kind = 'pid'\n", trial=trial
    )
    assert three.controller_text == "kind = 'pid'\n"
    assert three.trial == trial
    assert three.to_dict()["trial"] == trial
    assert "tried in 1 scenarios" in three.summary()
    two.promote(three.number, reason="all scenarios were passed")
    assert two.rollback(reason="worse").controller_text is None
    assert two.version(1).trial == {}


def test_the_controller_of_a_pair_never_changes(two: jt.TwinStore):
    two.add(fit(), reason="retuned", controller="kind = 'pid'\n")
    for statement in ("UPDATE controllers SET controller = 'x'", "DELETE FROM controllers"):
        assert refused(statement, two.path) == "rows of controllers are never changed"


def test_a_store_of_before_there_were_pairs_is_read_and_gets_them(two: jt.TwinStore):
    connection = sqlite3.connect(two.path)
    tables = "SELECT count(*) FROM sqlite_master WHERE name = 'controllers'"
    assert connection.execute(tables).fetchone() == (0,)  # as it was made before
    connection.close()
    assert [version.controller_text for version in two.versions] == [None, None]
    assert two.add(fit(), reason="retuned", controller="text").controller_text == "text"
