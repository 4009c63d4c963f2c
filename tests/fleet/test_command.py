"""`jaxtwin fleet` as a command: what it refuses before anything begins."""

from pathlib import Path

import pytest
from small_fleet import fleet_file

from jaxtwin.cli import run

REFUSED = {
    "no file": ("nothing.toml", "nothing.toml: expected a TOML file, which cannot be read"),
    "faults of real rigs": ("fleet.toml --faults a:drift", "--faults and --speed are those of"),
    "speed of real rigs": ("fleet.toml --speed 2", "--faults and --speed are those of rigs with"),
    "faults of an unknown rig": ("fleet.toml --virtual --faults x:y", "a rig of fleet.toml"),
    "a fault of no kind": ("fleet.toml --virtual --faults a:explode=now", "fault: expected words"),
    "a token in no folder": ("fleet.toml --token-file none/token", "there is no folder"),
    "a port of no machine": ("fleet.toml --host 192.0.2.1", "expected a free port"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_watched_is_refused_in_a_sentence(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    fleet_file(tmp_path)
    words, expected = REFUSED[case]
    assert run(["fleet", *words.split(), "--port", "0"]) == 2
    assert expected in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["fleet.toml"]
