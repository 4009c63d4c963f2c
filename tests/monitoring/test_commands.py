"""`jaxtwin monitor` and `jaxtwin observe` say what they find, as text, as JSON and by exit code."""

import json
from pathlib import Path

import pytest
from faulty_runs import bench, recording, write_sessions
from hand_clock import START, HandClock

from jaxtwin.cli import run
from jaxtwin.live import Greeting, Hello, Reading, Recorder, Sample
from jaxtwin.monitoring import MonitorCalibration


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fit, healthy recordings and one with a fault."""
    return write_sessions(tmp_path_factory.mktemp("monitor"))


@pytest.fixture(autouse=True)
def _in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.mark.slow
def test_an_alarm_ends_with_5_and_is_in_text_and_json(capsys: pytest.CaptureFixture[str]):
    words = "monitor fit.toml day2.csv hurt.csv --json found.json --out pictures"
    assert run(words.split()) == 5
    text = capsys.readouterr().out
    assert "day2: nothing found" in text
    assert "sudden: T1 is" in text
    healthy, hurt = json.loads(Path("found.json").read_text())["recordings"]
    assert healthy["alarms"] == 0
    assert hurt["alarms"] == sum(one["severity"] != "notice" for one in hurt["findings"]) > 0
    names = {"kind", "channel", "since_s", "found_s", "until_s", "size", "unit", "probability"}
    assert names < set(hurt["findings"][0])
    assert {path.name for path in Path("pictures").iterdir()} == {"day2.png", "hurt.png"}


@pytest.mark.slow
def test_a_calibration_is_kept_and_used_again():
    words = "monitor fit.toml day2.csv --healthy day1.csv --save healthy.toml"
    assert run(words.split()) == 0
    calibration = MonitorCalibration.load("healthy.toml")
    assert {tail.source for tail in calibration.tails["sum"]} == {"simulations"}
    words = "monitor fit.toml hurt.csv --calibration healthy.toml --days 7"
    assert run(words.split()) == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("monitor fit.toml day1.csv --save h.toml", "--save keeps what --healthy finds"),
        ("monitor fit.toml day1.csv --healthy day2.csv --calibration h.toml", "give one of"),
        ("monitor fit.toml day1.csv --days nan", "--days: expected a finite number"),
        ("monitor fit.toml day1.csv --days 0.01", "expected at least 3600 s"),
        ("monitor fit.toml day1.csv --calibration fit.toml", "fit.toml: sample_time_s: expected"),
        ("monitor fit.toml day1.csv --out fit.toml", "expected a folder, got a file"),
        ("monitor none.toml day1.csv", "none.toml"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_sentence(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
):
    assert run(words.split()) == 2
    assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_observe_raises_findings_of_a_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    hurt, clock = recording("gain", "T1", 0.8), HandClock()
    file = tmp_path / "session.db"
    assert hurt.temperatures is not None
    with Recorder(file, bench().rig, clock=clock) as recorder:
        recorder.write([Greeting("rig", START, Hello(2, "tclab", "b", cells=("H1", "H2")))])
        for n, (duty, row) in enumerate(zip(hurt.duty, hurt.temperatures, strict=True)):
            stamp = ("rig", "b", START + n * 10**9, n * 10**6, n)
            counts = tuple(round(1000 * float(part)) for part in duty)
            recorder.write([Reading(*stamp, row, False, None), Sample(*stamp, counts, None)])
    said = tmp_path / "said"
    words = ["observe", str(file), "--speed", "100000", "--alarm", f"echo $JAXTWIN_ALARM >> {said}"]
    assert run(words) == 5
    assert "sudden" in said.read_text().split()
    assert "alarm" in capsys.readouterr().out
