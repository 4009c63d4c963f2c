"""A session is recognised by what SQLite writes at the start of a file, and by the application."""

import sqlite3
from pathlib import Path

import pytest

from jaxtwin.io._session_file import APPLICATION, is_session

# The first sixteen bytes of a database, https://www.sqlite.org/fileformat.html, section 1.3.
MAGIC = b"SQLite format 3\x00"


@pytest.mark.parametrize(("application", "session"), [(APPLICATION, True), (0, False), (7, False)])
def test_a_database_of_another_application_is_no_session(
    tmp_path: Path, application: int, session: bool
):
    file = tmp_path / "some.db"
    database = sqlite3.connect(file)
    database.execute(f"PRAGMA application_id = {application}")
    database.execute("CREATE TABLE measured (value)")
    database.close()
    assert file.read_bytes().startswith(MAGIC)
    assert is_session(file) == session


def test_a_file_that_only_has_the_application_s_number_is_no_session(tmp_path: Path):
    """At bytes 68 to 71, where a database would have it."""
    file = tmp_path / "some.db"
    file.write_bytes(bytes(68) + APPLICATION.to_bytes(4, "big") + bytes(28))
    assert not is_session(file)


def test_what_is_no_file_is_no_session(tmp_path: Path):
    assert not is_session(tmp_path)
    assert not is_session(tmp_path / "none.db")
