"""Compiled programs on disk: whole or not at all, bounded, and never in anybody's way."""

import os
from pathlib import Path

import pytest

from jaxtwin._compilation import CacheState, _store, cache_state
from jaxtwin._compilation._store import ENDING, cache_folder, load, save


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("JAXTWIN_COMPILATION_CACHE", str(tmp_path / "compiled"))
    return tmp_path / "compiled"


def test_what_was_saved_is_loaded(folder):
    assert cache_folder() == folder
    assert load(folder, "name") is None
    save(folder, "name", b"program")
    assert load(folder, "name") == b"program"
    state = cache_state()
    assert (state.files, state.size) == (1, 32 + len(b"program"))


def test_only_the_user_may_look_into_the_folder(folder):
    """What is loaded from it is run."""
    save(folder, "name", b"program")
    assert folder.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(folder, mode):
    """What is loaded from it is run."""
    folder.mkdir()
    folder.chmod(mode)
    assert cache_folder() is None
    state = cache_state()
    assert state.folder is None
    assert state.reason == (
        f"off, {folder} is another user's or can be written to by others; chmod go-w mends that"
    )
    folder.chmod(0o700)
    assert cache_folder() == folder


def test_a_folder_of_another_user_is_not_used(folder, monkeypatch):
    save(folder, "name", b"program")
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert cache_folder() is None
    assert load(folder, "name") is None


@pytest.mark.parametrize("mode", [0o620, 0o602])
def test_a_program_that_others_may_write_to_is_not_loaded(folder, mode):
    save(folder, "name", b"program")
    (folder / f"name{ENDING}").chmod(mode)
    assert load(folder, "name") is None


def test_a_program_is_private_whatever_the_umask(folder):
    before = os.umask(0o002)
    try:
        save(folder, "name", b"program")
    finally:
        os.umask(before)
    assert (folder / f"name{ENDING}").stat().st_mode & 0o777 == 0o600
    assert load(folder, "name") == b"program"


def test_a_link_to_a_program_is_not_followed(folder):
    save(folder, "name", b"program")
    (folder / f"other{ENDING}").symlink_to(folder / f"name{ENDING}")
    assert load(folder, "other") is None


def test_files_of_others_in_the_folder_are_neither_counted_nor_deleted(folder, monkeypatch):
    monkeypatch.setattr(_store, "MAX_CACHE", 200)
    folder.mkdir(mode=0o700)
    (folder / "archive.tar").write_bytes(bytes(10_000))
    save(folder, "one", bytes(100))
    save(folder, "two", bytes(100))
    assert {file.name for file in folder.iterdir()} == {"archive.tar", f"two{ENDING}"}
    assert cache_state().files == 1


@pytest.mark.parametrize("damage", [b"", b"short", b"x" * 39], ids=["empty", "cut", "overwritten"])
def test_a_damaged_program_is_not_loaded(folder, damage):
    save(folder, "name", b"program")
    (folder / f"name{ENDING}").write_bytes(damage)
    assert load(folder, "name") is None
    save(folder, "name", b"program")
    assert load(folder, "name") == b"program"


def test_a_full_folder_loses_what_was_not_used_for_longest(folder, monkeypatch):
    monkeypatch.setattr(_store, "MAX_CACHE", 3 * (32 + 100))
    for number, name in enumerate(("old", "older", "new")):
        save(folder, name, bytes(100))
        os.utime(folder / (name + ENDING), (number, number))
    assert load(folder, "old")  # and so it was used last
    save(folder, "newest", bytes(100))
    assert {file.stem for file in folder.iterdir()} == {"old", "new", "newest"}


def test_a_program_is_saved_although_another_process_deletes_the_same_old_ones(folder, monkeypatch):
    """What was there when the folder was read is gone when it is its turn to go."""
    monkeypatch.setattr(_store, "MAX_CACHE", 200)
    monkeypatch.setattr(_store, "_programs", lambda _: [(0.0, folder / "gone", 100)])
    save(folder, "new", bytes(100))
    assert load(folder, "new") == bytes(100)


def test_turned_off_it_keeps_nothing(folder, monkeypatch):
    monkeypatch.setenv("JAXTWIN_COMPILATION_CACHE", "off")
    assert cache_folder() is None
    assert not folder.exists()
    assert cache_state().folder is None


def test_a_folder_that_cannot_be_written_to_keeps_nothing(folder, monkeypatch):
    """What lies in it is not counted, and the reason names it."""
    save(folder, "name", b"program")
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert cache_state() == CacheState(None, f"off, {folder} cannot be written to", 0, 0)


def test_a_folder_that_cannot_be_made_stops_nobody(tmp_path):
    (tmp_path / "file").write_text("no folder")
    folder = tmp_path / "file" / "compiled"
    save(folder, "name", b"program")
    assert load(folder, "name") is None
