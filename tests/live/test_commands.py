"""The commands: what they print, what they refuse, and that they stop when asked."""

import json
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hand_clock import START, HandClock

from jaxtwin.cli import run
from jaxtwin.errors import LinkError, RecordingError
from jaxtwin.io import Session, read_recording
from jaxtwin.live import (
    Event,
    Greeting,
    Hello,
    Reading,
    Recorder,
    Sample,
    SystemClock,
    TcpServer,
    VirtualRig,
    deframe,
    serve,
)
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


@pytest.fixture
def recording(rig: Rig, tmp_path: Path, clock: HandClock) -> Path:
    file = tmp_path / "session.db"
    hello = Hello(2, "dual-cell", "b", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)
    records: list = [Greeting("l", START, hello)]
    for number in range(200):
        stamp = (START + number * 10**8, number * 10**5, number)
        records.append(Sample("l", "b", *stamp, (51, 102), 16.0))
        records.append(Reading("l", "b", *stamp, np.full(15, 20.0 + number / 100), False, None))
    with Recorder(file, rig, clock=clock) as recorder:
        clock.turn(20)
        recorder.write(records)
    return file


def test_a_recording_is_exported_as_it_is_read(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run.csv"
    assert run(["export", str(recording), str(out), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == {"samples": 20, "gaps_s": []}
    exported, read = read_recording(out), read_recording(recording)
    assert exported.fingerprint == read.fingerprint
    assert read.duty[0].tolist() == [51 / 255, 102 / 255]
    # Readings at 0.5 ... 1.4 s lie within half a step of 1 s: mean of 20.05 ... 20.14 degC.
    assert read.temperatures is not None
    assert read.temperatures[1, 0] == pytest.approx(20.095)


def test_an_export_replaces_nothing_unasked(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    out.write_text("precious")
    assert run(["export", str(recording), str(out)]) == 2
    assert out.read_text() == "precious"
    assert run(["export", str(recording), str(out), "--overwrite"]) == 0
    assert out.read_text() != "precious"


@pytest.mark.slow
def test_what_a_device_says_does_not_reach_the_terminal_as_commands(
    recording: Path, rig: Rig, clock: HandClock, capsys: pytest.CaptureFixture[str]
) -> None:
    clock.turn(100)
    with Recorder(recording, rig, append=True, clock=clock) as recorder:
        recorder.write([Event("l", clock.now(), "\x1b]0;owned\x07", "\x1b[2J")])
    assert run(["watch", str(recording), "--speed", "100000"]) == 0
    assert "\x1b]0" not in capsys.readouterr().out
    assert run(["no\x1b[2J"]) == 2
    assert "\x1b" not in capsys.readouterr().err


LINK = ["--link", "socket://127.0.0.1:1"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "missing.db", "run.csv"], "missing.db: no such file"),
        (["virtual-rig", "dual-cell", "--pty", "--port", "0"], "give one of --port, --pty"),
        (["virtual-rig", "dual-cell", "--faults", "burn=1"], "fault: expected words like"),
        (["record", "dual-cell", "--link", "x://y", "--out", "s.db"], "expected a serial port"),
        (["record", "dual-cell", *LINK, "--out", "no/s.db"], "there is no folder"),
        (["record", "dual-cell", *LINK, "--out", "s.csv"], "got '.csv'"),
        (["drive", "dual-cell", *LINK, "--duty", "0:2", "--out", "s.db"], "0:2"),
        (["drive", "dual-cell", "--link", "x://y", "--duty", "0:1", "--out", "s.db"], "x://y"),
        (["drive", "dual-cell", *LINK], "give either --duty or --plan"),
        (["drive", "dual-cell", *LINK, "--plan", "no.csv"], "no.csv: expected a file"),
        (["observe", "a.db", "--out", "b.db"], "--out records a live rig, with --link"),
        (["watch", "missing.db"], "missing.db: no such recording"),
        (["watch", "dual-cell"], "a rig is watched with --link"),
    ],
)
def test_a_wrong_command_is_one_clear_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("address", ["nowhere", "127.0.0.1:", "127.0.0.1:99999", "no such host:1"])
def test_an_invalid_address_is_refused_with_what_is_expected(address: str) -> None:
    with pytest.raises(LinkError, match="expected HOST:PORT"):
        TcpServer(address)


@pytest.mark.slow
def test_a_recording_is_watched_to_its_end(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["watch", str(recording), "--speed", "1000"]) == 0
    shown = capsys.readouterr().out
    assert "T11" in shown
    assert "22.0" in shown


def samples_in(file: Path) -> int:
    """How many samples a recording holds that may not have begun yet."""
    try:
        with Session(file) as session:
            return session.database.execute("SELECT count(*) FROM samples").fetchone()[0]
    except RecordingError:
        return 0


@pytest.mark.slow
def test_a_rig_is_recorded_until_a_polite_kill(twin: Twin, tmp_path: Path) -> None:
    out = tmp_path / "session.db"
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    thread = threading.Thread(target=serve, args=(VirtualRig(twin), server, SystemClock(), stop))
    thread.start()
    command = [sys.executable, "-m", "jaxtwin.cli", "record", "dual-cell"]
    command += ["--link", server.url, "--out", str(out)]
    try:
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            while samples_in(out) == 0 and process.poll() is None:
                stop.wait(0.05)
            process.send_signal(signal.SIGTERM)
            printed, _ = process.communicate()
    finally:
        stop.set()
        thread.join()
        server.close()
    assert process.returncode == 0
    assert f"samples from {server.url}" in printed
    assert samples_in(out) > 0
    with Session(out) as session:
        assert session.database.execute("SELECT ended FROM runs").fetchone() == ("stopped",)


@pytest.mark.slow
def test_an_observed_rig_is_recorded_with_its_estimates(tmp_path: Path) -> None:
    server, stop, out = TcpServer("127.0.0.1:0"), threading.Event(), tmp_path / "session.db"
    device = VirtualRig(Twin("tclab"))
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    try:
        words = ["observe", "tclab", "--link", server.url, "--out", str(out), "--duration", "3"]
        assert run(words) == 0
    finally:
        stop.set()
        thread.join()
        server.close()
    with Session(out) as session:
        found = session.estimates()
        (label,) = session.database.execute("SELECT DISTINCT twin FROM estimates").fetchone()
    assert label == "values of the rig file"
    place = found.columns.index("channel_T1_degC")
    np.testing.assert_allclose(found.values[:, place], 23.0, atol=1.0)  # at rest in its room
    assert len(found.time) > 0


def documents_in(file: Path) -> list[tuple[str, dict]]:
    with Session(file) as session:
        rows = session.database.execute("SELECT kind, content FROM documents ORDER BY id")
        return [(kind, json.loads(content)) for kind, content in rows]


@pytest.mark.slow
def test_how_a_drive_ended_shows_in_its_exit_code_and_in_the_recording(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After Ctrl-C and after a trip; no password of the command line is in the recording."""
    device, server, stop = VirtualRig(twin), TcpServer("127.0.0.1:0"), threading.Event()
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()

    def press_ctrl_c() -> None:
        while device.pwm == (0, 0) and not stop.is_set():
            stop.wait(0.01)
        signal.raise_signal(signal.SIGINT)

    shown = ["drive", "--link", "mqtt://anna:secret@host/topic"]
    monkeypatch.setattr(sys, "argv", ["jaxtwin", *shown])
    command = ["drive", "dual-cell", "--link", server.url, "--duty", "0:0.5", "--operator", "anna"]
    interrupted, tripped = tmp_path / "interrupted.db", tmp_path / "tripped.db"
    presser = threading.Thread(target=press_ctrl_c)
    try:
        presser.start()
        assert run([*command, "--out", str(interrupted)]) == 130
        presser.join()
        device.stage.trip("watchdog")
        assert run([*command, "--out", str(tripped)]) == 3
    finally:
        stop.set()
        thread.join()
        server.close()
    ends = {}
    for file in (interrupted, tripped):
        (begin, plan), (end, ends[file]) = documents_in(file)
        assert (begin, end) == ("start", "stop")
        assert (plan["operator"], plan["plan"]["duty"]) == ("anna", "0:0.5")
        assert plan["command"] == "jaxtwin drive --link 'mqtt://anna:***@host/topic'"
        assert b"secret" not in file.read_bytes()
    assert (ends[interrupted]["status"], ends[interrupted]["off"]) == ("stopped", True)
    assert (ends[tripped]["status"], ends[tripped]["kind"]) == ("tripped", "device-trip")


@pytest.mark.slow
def test_a_plan_from_a_file_is_driven_to_its_end(twin: Twin, tmp_path: Path) -> None:
    """The duty of a .csv file, as `jaxtwin design` writes it; the recording says which file."""
    device, server = VirtualRig(twin, speed=4), TcpServer("127.0.0.1:0")
    stop = threading.Event()
    plan, out = tmp_path / "plan.csv", tmp_path / "session.db"
    plan.write_text("time_s,duty_P1,duty_P2\n0,0.4,0.2\n4,0.4,0.2\n8,0,0\n")
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    command = ["drive", "dual-cell", "--link", server.url, "--plan", str(plan), "--out", str(out)]
    try:
        assert run(command) == 0
    finally:
        stop.set()
        thread.join()
        server.close()
    (_, start), (_, end) = documents_in(out)
    assert start["plan"] == {"file": str(plan), "duration_s": 8.0}
    assert (end["status"], end["off"]) == ("completed", True)
    with Session(out) as session:
        driven = session.experiment().duty
    assert driven.max(axis=0).tolist() == pytest.approx([102 / 255, 51 / 255])


def test_a_virtual_rig_says_where_it_listens_and_serves(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    served = []

    def for_a_moment(device: VirtualRig, server: TcpServer, *_: object) -> None:
        host, port = server.url.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port))) as client:
            for now in range(0, 10**9, 10**8):
                server.tick(device.due(now), device)
            served.extend(deframe(b"", client.recv(1000)).frames)

    monkeypatch.setattr("jaxtwin.live.serve", for_a_moment)
    command = ["virtual-rig", "dual-cell", "--port", "0", "--speed", "5", "--faults", "drop=0.1"]
    assert run(command) == 0
    assert "dual-cell at socket://127.0.0.1:" in capsys.readouterr().out
    assert served[0].startswith("hello version=2 rig=dual-cell")
    assert "rate=5" in served[0]
