"""A report replaces a report and nothing else, as a whole or not at all."""

import pytest

from jaxtwin import JaxtwinError
from jaxtwin.report._page import PAGE, check_folder, new_folder, page_html

OURS = page_html("t", [], [], "f")


def fill(folder, mark: str) -> None:
    with new_folder(folder) as part:
        (part / PAGE).write_text(OURS, encoding="utf-8")
        (part / mark).touch()


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_an_older_report_is_replaced_whole(tmp_path):
    fill(tmp_path / "report", "old.png")
    fill(tmp_path / "report", "new.png")
    assert names(tmp_path / "report") == [PAGE, "new.png"]
    assert names(tmp_path) == ["report"]


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / "report").mkdir()
    fill(tmp_path / "report", "new.png")
    assert names(tmp_path / "report") == [PAGE, "new.png"]


def test_a_failure_leaves_the_older_report_and_nothing_else(tmp_path):
    fill(tmp_path / "report", "old.png")

    def fail_half_way():
        with new_folder(tmp_path / "report") as part:
            (part / "half.png").touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail_half_way()
    assert names(tmp_path / "report") == [PAGE, "old.png"]
    assert names(tmp_path) == ["report"]


@pytest.mark.parametrize("content", ["", "<html>somebody's page</html>"])
def test_a_folder_with_something_else_is_left_alone(tmp_path, content):
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / PAGE).write_text(content)
    (folder / "data.csv").write_text("precious")
    with pytest.raises(JaxtwinError, match=r"thesis: expected .* or an older report of jaxtwin"):
        fill(folder, "new.png")
    assert names(folder) == ["data.csv", PAGE]
    assert names(tmp_path) == ["thesis"]


def test_a_file_and_a_link_are_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder", target_is_directory=True)
    for name in ("file", "link"):
        with pytest.raises(JaxtwinError, match=name):
            check_folder(tmp_path / name)


def test_the_folder_above_must_be_there(tmp_path):
    with pytest.raises(JaxtwinError, match="that can be written to, got none"):
        check_folder(tmp_path / "nowhere" / "report")
