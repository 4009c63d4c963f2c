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
import typer
from hand_clock import START, HandClock
from typer.testing import CliRunner

import jaxtwin as jt
from jaxtwin.io import read_recording
from jaxtwin.live import (
    Greeting,
    Reading,
    Recorder,
    Sample,
    Session,
    SystemClock,
    TcpServer,
    VirtualRig,
    deframe,
    serve,
)
from jaxtwin.live._commands import add_commands
from jaxtwin.live._messages import Hello
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

APP = typer.Typer()
add_commands(APP)


@pytest.fixture
def recording(rig: Rig, tmp_path: Path, clock: HandClock) -> Path:
    file = tmp_path / "session.db"
    hello = Hello(1, "dual-cell", "b", cells=("P1", "P2"), camera=(80, 60))
    records: list = [Greeting("l", START, hello)]
    for number in range(200):
        stamp = (START + number * 10**8, number * 10**5, number)
        records.append(Sample("l", "b", *stamp, (51, 102), 16.0))
        records.append(Reading("l", "b", *stamp, np.full(15, 20.0 + number / 100), False, None))
    with Recorder(file, rig, clock=clock) as recorder:
        clock.turn(20)
        recorder.write(records)
    return file


def test_a_recording_is_exported_as_it_is_read(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    result = CliRunner().invoke(APP, ["export", str(recording), str(out), "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {"samples": 20, "gaps": []}
    exported, read = read_recording(out), read_recording(recording)
    assert exported.fingerprint == read.fingerprint
    assert read.duty[0].tolist() == [51 / 255, 102 / 255]
    # Readings at 0.5 ... 1.4 s lie within half a step of 1 s: mean of 20.05 ... 20.14 degC.
    assert read.temperatures is not None
    assert read.temperatures[1, 0] == pytest.approx(20.095)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "missing.db", "run.csv"], "missing.db: no such file"),
        (["virtual-rig", "dual-cell"], "allowed is one of"),
        (["virtual-rig", "dual-cell", "--tcp", "nowhere"], "allowed is HOST:PORT"),
        (["record", "dual-cell", "--link", "x://y", "--out", "OUT"], "allowed are a serial port"),
        (["watch", "missing.db"], "missing.db: no such file"),
    ],
)
def test_a_wrong_command_is_one_clear_error(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    arguments = [str(tmp_path / "out.db") if word == "OUT" else word for word in arguments]
    result = CliRunner().invoke(APP, arguments)
    assert isinstance(result.exception, jt.JaxtwinError)
    assert message in str(result.exception)


def test_a_recording_is_watched_to_its_end(recording: Path) -> None:
    result = CliRunner().invoke(APP, ["watch", str(recording), "--speed", "1000"])
    assert result.exit_code == 0
    assert "T11" in result.stdout
    assert "22.0" in result.stdout


def test_a_rig_is_recorded_until_a_polite_kill(twin: Twin, tmp_path: Path) -> None:
    out = tmp_path / "session.db"
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    serving = (VirtualRig(twin), server, SystemClock(), stop)
    thread = threading.Thread(target=serve, args=serving)
    thread.start()
    command = [sys.executable, "-m", "jaxtwin.cli", "record", "dual-cell"]
    command += ["--link", server.url, "--out", str(out)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        assert process.stdout is not None
        seen = ""
        while "live" not in seen:
            seen += process.stderr.read(1)
        process.send_signal(signal.SIGTERM)
        printed = process.stdout.read()
    stop.set()
    thread.join()
    server.close()
    assert process.returncode == 0
    assert "samples from socket://" in printed
    with Session(out) as session:
        assert session.database.execute("SELECT ended FROM runs").fetchone() == ("stopped",)
        assert session.database.execute("SELECT count(*) FROM samples").fetchone()[0] > 0


def test_a_virtual_rig_says_where_it_listens_and_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    served = []

    def for_a_moment(device: VirtualRig, server: TcpServer, *_: object) -> None:
        host, port = server.url.removeprefix("socket://").split(":")
        with socket.create_connection((host, int(port))) as client:
            for now in range(0, 10**9, 10**8):
                server.tick(device.due(now), device)
            served.extend(deframe(b"", client.recv(1000)).frames)

    monkeypatch.setattr("jaxtwin.live._serve.serve", for_a_moment)
    command = ["virtual-rig", "dual-cell", "--tcp", ":0", "--speed", "5", "--faults", "drop=0.1"]
    result = CliRunner().invoke(APP, command)
    assert result.exit_code == 0
    assert "dual-cell at socket://127.0.0.1:" in result.stdout
    assert served[0].startswith("hello version=1 rig=dual-cell")
    assert "rate=5" in served[0]
