"""What the commands do with the findings of a monitor beside a rig."""

import json
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from faulty_runs import bench
from findings import ALARM, NOTICE

from jaxtwin.cli import run
from jaxtwin.commands._monitored import MonitorOptions
from jaxtwin.data import data_folder
from jaxtwin.io import Session
from jaxtwin.live import (
    Finding,
    Reading,
    Record,
    RigState,
    SystemClock,
    TcpServer,
    VirtualRig,
    serve,
)


class Announcer:
    """A monitor that finds something in the third reading after the start."""

    def __init__(self, finding: Finding, on_finding: Callable[[Finding], None]):
        self.finding, self.on_finding, self.seen = finding, on_finding, 0

    def on_record(self, record: Record, state: RigState) -> None:
        self.seen += isinstance(record, Reading)
        if isinstance(record, Reading) and self.seen == 3:
            self.on_finding(self.finding)

    def on_time(self, state: RigState, now: int) -> None:
        pass


@pytest.fixture
def link() -> Iterator[str]:
    """The address of a virtual rig."""
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    # Four times as fast: after a run the readings are watched for half a minute of the rig.
    device = VirtualRig(bench(), speed=4)
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    yield server.url
    stop.set()
    thread.join()
    server.close()


def events_in(file: Path) -> list[tuple[str, str]]:
    with Session(file) as session:
        rows = session.database.execute("SELECT kind, detail FROM events ORDER BY id").fetchall()
    return [row for row in rows if row[0] in ("alarm", "notice")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "stops", "finding", "code"),
    [
        ("record", True, ALARM, 5),
        ("record", False, NOTICE, 0),
        ("drive", False, ALARM, 5),
        ("drive", False, NOTICE, 0),
        ("drive", True, ALARM, 5),
        ("control", True, ALARM, 5),
    ],
)
def test_findings_are_raised_on_the_links_that_alarms_have(
    command: str,
    stops: bool,
    finding: Finding,
    code: int,
    link: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
):
    """In the log, as an event of the recording, by the user's command and by the exit code. A rig
    whose file says so is monitored and stopped without being asked to."""
    monkeypatch.chdir(tmp_path)
    text = (data_folder() / "rigs" / "tclab.toml").read_text()
    limits = "limits = { stop_on_alarm = true," if stops else "limits = {"
    Path("tclab.toml").write_text(text.replace("limits = {", limits))
    Path("pid.toml").write_text(
        'format = 1\nrig = "tclab"\nkind = "pid"\nsample_time = "1 s"\nKp = "0.01 1/K"\n'
    )

    def made(options: Any, twin: Any, on_finding: Any) -> Announcer:
        return Announcer(finding, on_finding)

    monkeypatch.setattr(MonitorOptions, "monitor", made)
    words = {
        "record": ["--monitor", "--duration", "4"],
        "drive": ["--duty", "0:0.1", "--duration", "16", *([] if stops else ["--monitor"])],
        "control": ["--controller", "pid.toml", "--reference", "0:25", "--duration", "16"],
    }
    hook = ["--alarm", "echo $JAXTWIN_ALARM >> said"]
    with caplog.at_level(logging.WARNING, "jaxtwin.live"):
        found = run(
            [command, "tclab.toml", "--link", link, "--out", "session.db", *words[command], *hook]
        )
    assert found == code
    label = f"{finding.kind}: {finding.detail} ({finding.severity})"
    is_alarm = finding is ALARM
    assert (("alarm" if is_alarm else "notice"), label) in events_in(Path("session.db"))
    assert any("T1 is 3 K above" in text for text in caplog.messages) == is_alarm
    assert Path("said").exists() == is_alarm
    if command != "record":
        with Session("session.db") as session:
            query = "SELECT content FROM documents WHERE kind = 'stop'"
            (content,) = session.database.execute(query).fetchone()
        assert json.loads(content)["kind"] == ("alarm" if stops else "")


def test_files_of_a_monitor_are_refused_without_one(capsys: pytest.CaptureFixture[str]):
    words = "drive tclab --link socket://127.0.0.1:1 --duty 0:0.1 --calibration healthy.toml"
    assert run(words.split()) == 2
    assert "add --monitor" in capsys.readouterr().err
