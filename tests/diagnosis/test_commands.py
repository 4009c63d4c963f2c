"""`jaxtwin diagnose` says why, as text, as JSON and by exit code."""

import json
from pathlib import Path

import pytest
from faulty_runs import write_sessions

from jaxtwin.cli import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fit, a healthy recording and one with a fault."""
    return write_sessions(tmp_path_factory.mktemp("diagnose"))


@pytest.fixture(autouse=True)
def _in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.mark.slow
def test_a_cause_ends_with_5_and_is_in_text_and_json(capsys: pytest.CaptureFixture[str]):
    words = "diagnose fit.toml day2.csv hurt.csv --healthy day1.csv --json found.json --out images"
    assert run(words.split()) == 5
    text = capsys.readouterr().out
    assert "day2: healthy" in text
    assert "gain T1 since 500 s" in text
    healthy, hurt = json.loads(Path("found.json").read_text())["recordings"]
    assert healthy["causes"] == []
    best = hurt["causes"][0]["explanations"][0]
    assert best["name"] == "gain T1"
    assert best["lower"] < best["size"] < best["upper"]
    assert {path.name for path in Path("images").iterdir()} == {"day2.png", "hurt.png"}


@pytest.mark.slow
def test_a_bundled_rig_and_recording_are_taken_by_their_names(capsys: pytest.CaptureFixture[str]):
    """As match and Twin take them."""
    words = ["diagnose", "dual-cell", "synthetic-A", "--fault", "gain T11"]
    assert run(words) in (0, 5)
    assert "synthetic-A: " in capsys.readouterr().out


@pytest.mark.slow
def test_only_the_faults_that_are_asked_for_are_looked_for(capsys: pytest.CaptureFixture[str]):
    words = ["diagnose", "fit.toml", "hurt.csv", "--fault", "gain T2", "--fault", "age H2"]
    assert run(words) == 5
    assert "none of these" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("diagnose fit.toml day1.csv --out fit.toml", "expected a folder, got a file"),
        ("diagnose none.toml day1.csv", "none.toml"),
        ("diagnose fit.toml day1.csv --fault loosen", "expected names of tclab, got 'loosen'"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_sentence(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
):
    assert run(words.split()) == 2
    assert message in " ".join(capsys.readouterr().err.split())
