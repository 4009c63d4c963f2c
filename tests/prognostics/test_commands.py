"""`jaxtwin health` says how parameters change, as text, as JSON and by exit code."""

import json
from pathlib import Path

import pytest
from aged_sessions import session

from jaxtwin.cli import run


@pytest.fixture(autouse=True)
def _fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, value in (("a", 2.0), ("b", 2.1), ("c", 2.21)):
        session(value).save(f"{name}.toml")


@pytest.mark.slow
def test_the_trend_is_in_text_json_and_chart(capsys: pytest.CaptureFixture[str]):
    words = "health a.toml b.toml c.toml --times 2026-01-01,2026-01-11,2026-01-21 --name R_E"
    assert run([*words.split(), "--json", "h.json", "--out", "h.png"]) == 0
    assert "what changed most: R_E, +11 %" in capsys.readouterr().out
    found = json.loads(Path("h.json").read_text())
    assert found["sessions"] == ["a", "b", "c"]
    assert found["times"] == [0.0, 10.0, 20.0]
    assert found["parameters"]["R_E"]["change"] == pytest.approx(0.105, abs=1e-3)
    assert Path("h.png").stat().st_size > 1000


def test_the_exit_code_is_5_where_a_limit_is_likely_passed():
    words = "health a.toml b.toml c.toml --name R_E --limit R_E=2.3"
    assert run([*words.split(), "--within", "5"]) == 5
    assert run([*words.split(), "--within", "0"]) == 0
    assert run([*words.split(), "--within", "0", "--probability", "0.001"]) == 5


def test_the_exit_code_is_4_where_a_match_did_not_converge():
    session(2.2, converged=False).save("c.toml")
    assert run(["health", "a.toml", "b.toml", "c.toml", "--name", "R_E"]) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("health a.toml b.toml", "expected 3 or more"),
        ("health a.toml b.toml c.toml --limit R_E", "a parameter and a number, such as R_E=2.6"),
        ("health a.toml b.toml c.toml --limit R_E=2 --limit R_E=3", "expected each parameter once"),
        ("health a.toml b.toml c.toml --times 1,2", "one for each of 3 sessions, got 2"),
        ("health none.db", "there is no such store"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_sentence(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
):
    assert run(words.split()) == 2
    assert message in " ".join(capsys.readouterr().err.split())
