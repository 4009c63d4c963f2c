"""What `jaxtwin record` does for a recording that nobody watches: files by day, signs of life."""

import json
import socket
import subprocess
from pathlib import Path

import pytest
from hand_clock import HandClock, ScriptedTransport, stepped_bench

from jaxtwin import load_rig
from jaxtwin.commands._record import Heartbeat, RecordedDays
from jaxtwin.io import Session
from jaxtwin.live import Data, Hello, encode

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)


def test_a_new_day_is_a_new_file_and_the_old_one_has_its_checksum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, clock, today = load_rig("dual-cell"), HandClock(), ["2026-01-31"]
    monkeypatch.setattr(RecordedDays, "_today", lambda self: today[0])
    reads = [encode(HELLO), *[encode(Data(n, n * 1000, (0, 0))) for n in range(10)]]
    opener = lambda: ScriptedTransport(*reads)  # noqa: E731
    options = {"daily": True, "append": False, "keep_frames": False}
    with RecordedDays(tmp_path / "s.db", rig, **options) as days:
        bench = stepped_bench(rig, {"link": opener}, clock, journal=days.recorder)
        for turn in range(15):
            if turn == 6:
                today[0] = "2026-02-01"
            bench.poll()
            days.turn(bench)
    counts = {}
    for file in sorted(tmp_path.glob("s-*.db")):
        with Session(file) as session:
            rows = session.database.execute("SELECT count(*), min(seq), max(seq) FROM samples")
            counts[file.name] = rows.fetchone()
    (first, before), (second, after) = counts.items()
    assert (first, second) == ("s-2026-01-31.db", "s-2026-02-01.db")
    assert before[0] + after[0] == 10
    assert after[1] == before[2] + 1
    subprocess.run(["sha256sum", "--check", f"{first}.sha256"], cwd=tmp_path, check=True)


def test_systemd_and_a_file_hear_that_it_is_alive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind(str(address))
        monkeypatch.setenv("NOTIFY_SOCKET", str(address))
        heartbeat = Heartbeat(tmp_path / "health.json")
        heartbeat.ready()
        for records, now in enumerate((5.0, 5.99, 6.01, 7.0)):  # once a second
            monkeypatch.setattr("jaxtwin.commands._record.time.monotonic", lambda now=now: now)
            heartbeat.beat({"records": records})
        received = [supervisor.recv(100) for _ in range(3)]
        assert received == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
    health = json.loads((tmp_path / "health.json").read_text())
    assert health["records"] == 2
