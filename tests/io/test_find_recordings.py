"""Where recordings are looked for."""

from pathlib import Path

import pytest

from jaxtwin.errors import RecordingError
from jaxtwin.io import TWO_CELL, find_recordings
from jaxtwin.io._fetch import cache_folder

NAMES = ("a.mat", "single-cell/b.mat")


@pytest.fixture
def nowhere(tmp_path, monkeypatch) -> Path:
    """A current directory, a home and a variable that lead to no recordings."""
    work = tmp_path / "checkout"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.delenv("JAXTWIN_RECORDINGS", raising=False)
    monkeypatch.setattr("jaxtwin.io._fetch.cache_folder", lambda: tmp_path / "cache")
    return tmp_path


def put(folder: Path, *names: str) -> Path:
    """A folder with files of these names."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def test_in_the_folder_given(nowhere):
    folder = put(nowhere / "given", *NAMES)
    assert find_recordings(folder, NAMES) == (folder / "a.mat", folder / "single-cell" / "b.mat")
    assert find_recordings(str(folder), NAMES[:1]) == (folder / "a.mat",)


def test_without_the_inner_folder_as_the_authors_publish_them(nowhere):
    folder = put(nowhere / "given", "b.mat")
    assert find_recordings(folder, NAMES[1:]) == (folder / "b.mat",)


def test_the_order_of_places(nowhere, monkeypatch):
    """The argument, the variable, ../shared/recordings, the cache: the earlier one wins."""
    places = [nowhere / "cache", nowhere / "shared" / "recordings", nowhere / "variable"]
    for place in places:
        put(place, *NAMES)
        if place.name == "variable":
            monkeypatch.setenv("JAXTWIN_RECORDINGS", str(place))
        found, _ = find_recordings(names=NAMES)
        assert found.resolve() == place / "a.mat"
    given = put(nowhere / "given", *NAMES)
    assert find_recordings(given, NAMES)[0] == given / "a.mat"


def test_beside_the_checkout_from_wherever_it_is_run(nowhere, monkeypatch):
    """Of an installed package, whose folder is no checkout, nothing lies beside it."""
    checkout = put(nowhere / "projects" / "jaxtwin", "src/jaxtwin/io/_fetch.py")
    module = checkout / "src" / "jaxtwin" / "io" / "_fetch.py"
    monkeypatch.setattr("jaxtwin.io._fetch.__file__", str(module))
    shared = put(nowhere / "projects" / "shared" / "recordings", *NAMES)
    with pytest.raises(RecordingError):
        find_recordings(names=NAMES)
    put(checkout, "pyproject.toml")
    assert find_recordings(names=NAMES)[0] == shared.resolve() / "a.mat"


def test_a_place_that_holds_only_some_of_them_is_passed_over(nowhere):
    put(nowhere / "shared" / "recordings", NAMES[0])
    put(nowhere / "cache", *NAMES)
    assert find_recordings(names=NAMES)[0] == nowhere / "cache" / "a.mat"


def test_a_folder_that_was_asked_for_is_not_replaced_by_another(nowhere, monkeypatch):
    put(nowhere / "cache", *NAMES)
    wrong = nowhere / "wrong"
    with pytest.raises(RecordingError, match=r"looked in: .*wrong \(no such folder\)\. Name"):
        find_recordings(wrong, NAMES)
    monkeypatch.setenv("JAXTWIN_RECORDINGS", str(put(wrong, "other.mat")))
    with pytest.raises(RecordingError, match=r"looked in: \S*wrong \(without a\.mat, single-"):
        find_recordings(names=NAMES)


def test_every_place_is_named_where_none_has_them(nowhere):
    with pytest.raises(RecordingError) as caught:
        find_recordings(names=["no-such-recording.mat"])
    for part in ("shared/recordings", "cache", "JAXTWIN_RECORDINGS", "jaxtwin data fetch"):
        assert part in str(caught.value)


def test_the_paper_s_step_recordings_are_what_is_looked_for(nowhere):
    folder = put(nowhere / "given", *(recording.name for recording in TWO_CELL))
    names = [path.name for path in find_recordings(folder)]
    assert names == [f"peltierMIMOStepSec{zone}.mat" for zone in "ABC"]


def test_the_cache_is_the_user_s_own():
    assert cache_folder().parts[-2:] == ("jaxtwin", "recordings")
