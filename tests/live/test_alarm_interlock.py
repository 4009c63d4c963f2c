"""An alarm of a monitor switches the cells off where the rig file says so, and nowhere else."""

import json
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from faulty_runs import bench
from hand_clock import HandClock, virtual_bench

from jaxtwin import Experiment, JaxtwinError, load_rig
from jaxtwin._errors import SafetyStop
from jaxtwin.cli import run
from jaxtwin.commands._monitored import MonitorOptions
from jaxtwin.data import data_folder
from jaxtwin.io import Session
from jaxtwin.live import (
    AlarmInterlock,
    Finding,
    Guard,
    Reading,
    Record,
    RigState,
    SystemClock,
    TcpServer,
    VirtualRig,
    drive,
    interlocks_of,
    serve,
)
from jaxtwin.monitoring import LiveMonitor
from jaxtwin.observers import live_observer
from jaxtwin.physics import Faults

ALARM = Finding("sudden", "T1 is 3 K above what is expected", "T1")
NOTICE = replace(ALARM, kind="changed", severity="notice")


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


def test_it_trips_on_the_first_alarm_and_on_no_notice():
    interlock, state = AlarmInterlock(), RigState()
    interlock.ring(NOTICE)
    assert interlock.on_time(state, 0) is None
    interlock.ring(ALARM)
    interlock.ring(replace(ALARM, kind="drift"))
    found = interlock.on_time(state, 0)
    assert found is not None
    assert (found.kind, found.channel) == ("alarm", "T1")
    assert found.detail == "alarm, sudden: T1 is 3 K above what is expected"
    assert interlock.settings == {"stop_on_alarm": True}


@pytest.mark.slow
def test_a_sensor_that_comes_loose_stops_a_run_if_it_is_wanted(clock: HandClock):
    """Its readings are 5 % nearer to the room from 150 s on, which no other interlock minds."""
    plan = Experiment.schedule("0:0.5/0.4", duration=200, cells=2)
    ends = {}
    for is_stopped in (False, True):
        faults = Faults.parse("gain=T1@150/0.95")
        device = VirtualRig(bench(), speed=10, controller_rate=1.0, faults=faults)
        raised: list[Finding] = []
        interlock = AlarmInterlock()

        def found(finding: Finding, to: AlarmInterlock = interlock, kept=raised) -> None:
            kept.append(finding)
            to.ring(finding)

        monitor = LiveMonitor(live_observer(bench()), found)
        guard = Guard([*interlocks_of(bench()), *([interlock] if is_stopped else [])])
        connection, begin = virtual_bench(bench().rig, device, clock), clock.now()
        try:
            ends[is_stopped] = drive(connection, guard, plan, consumers=[monitor])
        except SafetyStop as stop:
            ends[is_stopped] = stop.kind
        assert raised
        assert raised[0].kind == "sudden"
        assert raised[0].since is not None
        since = 10 * (raised[0].since - begin) / 1e9  # s of the rig
        assert since == pytest.approx(150, abs=15)
        assert not any(device.pwm)
        assert device.stage.trip_reason == ("stop" if is_stopped else "")
    assert ends == {False: "completed", True: "alarm"}


@pytest.mark.slow
def test_no_other_interlock_waits_for_it(clock: HandClock):
    """A rig that is too hot is stopped, whatever a monitor says."""
    rig = bench().rig
    assert rig.limits is not None
    cautious = replace(rig, limits=replace(rig.limits, temperature=273.15 + 30))
    twin = type(bench())(cautious)
    guard = Guard([*interlocks_of(twin), AlarmInterlock()])
    connection = virtual_bench(rig, VirtualRig(bench(), speed=10), clock)
    plan = Experiment.schedule("0:0.5/0.4", duration=400, cells=2)
    with pytest.raises(SafetyStop, match="the rig's limit is 30"):
        drive(connection, guard, plan)


def test_a_rig_file_says_whether_an_alarm_stops_it(tmp_path: Path):
    text = (data_folder() / "rigs" / "tclab.toml").read_text()
    file = tmp_path / "rig.toml"
    file.write_text(text.replace("limits = {", "limits = { stop_on_alarm = true,"))
    limits = load_rig(file).limits
    assert limits is not None
    assert limits.stop_on_alarm
    usual = bench().rig.limits
    assert usual is not None
    assert not usual.stop_on_alarm
    file.write_text(text.replace("limits = {", 'limits = { stop_on_alarm = "yes",'))
    with pytest.raises(JaxtwinError, match=r"limits\.stop_on_alarm"):
        load_rig(file)


@pytest.fixture
def link() -> Iterator[str]:
    """The address of a virtual rig."""
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    device = VirtualRig(bench())
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
        "drive": ["--duty", "0:0.1", "--duration", "4", *([] if stops else ["--monitor"])],
        "control": ["--controller", "pid.toml", "--reference", "0:25", "--duration", "4"],
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
