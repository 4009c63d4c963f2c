"""What does a recording lose when its recorder is killed, or its disk is full?

    python benchmarks/live_crashes.py --kills 100 --full 20

Kills: a recorder in a process of its own is killed with signal 9 at a random moment; it tells the
number of each sample that a reader of it would have seen. Full disks: a tmpfs of some megabytes
(needs root) is recorded into until it is full. Prints JSON.
"""

import argparse
import json
import os
import random
import signal
import sqlite3
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import jaxtwin as jt
from jaxtwin.errors import RecordingError
from jaxtwin.io import Session
from jaxtwin.live import Greeting, Hello, Reading, Recorder, Sample
from jaxtwin.rig import Rig

HELLO = Hello(2, "dual-cell", "bench", ("P1", "P2"), camera=(80, 60), watchdog=2.0)


def sample(seq: int, arrival: int) -> Sample:
    return Sample("link", "bench", arrival, seq * 1000, seq, (seq % 256, 0), 16.0)


def reading(seq: int, arrival: int) -> Reading:
    pixels = np.full((60, 80), seq % 65_536, np.uint16)
    return Reading(
        "link", "bench", arrival, seq * 1000, seq, np.full(15, float(seq)), False, pixels
    )


def record_for_ever(file: Path, rig: Rig, pipe: int) -> None:
    """Records in transactions of a few rows and says which ones are safe; never returns."""
    recorder = Recorder(file, rig, keep_frames=True)
    recorder.write([Greeting("link", time.time_ns(), HELLO)])
    seq = 0
    while True:
        now = time.time_ns()
        batch = [part for n in range(seq, seq + 5) for part in (sample(n, now), reading(n, now))]
        recorder.write(batch)
        seq += 5
        os.write(pipe, f"{seq - 1}\n".encode())
        time.sleep(0.002)


def kill_once(file: Path, rig: Rig, chance: random.Random) -> dict[str, float]:
    """One kill; what was lost."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        record_for_ever(file, rig, write)
    os.close(write)
    told = os.fdopen(read)
    told.readline()
    time.sleep(chance.uniform(0.0, 1.5))
    os.kill(child, signal.SIGKILL)
    killed = time.time_ns()
    os.waitpid(child, 0)
    safe = max([int(line) for line in told.read().split()] or [4])
    told.close()
    with Session(file) as session:
        execute = session.database.execute
        numbers = [seq for (seq,) in execute("SELECT seq FROM samples ORDER BY id")]
        values = execute('SELECT seq, "T11_degC", pixels FROM readings JOIN frames ON reading = id')
        wrong = sum(
            value != seq or np.frombuffer(content, "<u2")[0] != seq % 65_536
            for seq, value, content in values
        )
        (last,) = execute("SELECT max(arrival) FROM samples").fetchone()
        intact = execute("PRAGMA integrity_check").fetchone() == ("ok",)
    # The next recorder must be able to go on.
    Recorder(file, rig, append=True).close()
    return {
        "rows": len(numbers),
        "seen but lost": len(set(range(safe + 1)) - set(numbers)),
        "duplicated": len(numbers) - len(set(numbers)),
        "holes": int(numbers != list(range(len(numbers)))),
        "wrong values": int(wrong),
        "broken": int(not intact),
        "youngest row, s before the kill": (killed - last) * 1e-9,
    }


def kills(times: int) -> dict[str, float]:
    rig, chance = jt.load_rig("dual-cell"), random.Random(1)
    results = []
    for number in range(times):
        with tempfile.TemporaryDirectory() as folder:
            results.append(kill_once(Path(folder) / f"{number}.db", rig, chance))
    total = {key: sum(result[key] for result in results) for key in results[0]}
    youngest = "youngest row, s before the kill"
    total[youngest] = round(max(result[youngest] for result in results), 4)
    return {"kills": times, **total}


def fill_once(file: Path, rig: Rig, chance: random.Random) -> dict[str, float]:
    """Records until the disk is full; a reader looks on meanwhile."""
    recorder = Recorder(file, rig, keep_frames=True)
    recorder.write([Greeting("link", time.time_ns(), HELLO)])
    reader = Session(file) if chance.random() < 0.5 else None
    safe, error = 0, ""
    try:
        while True:
            batch = chance.randrange(1, 30)
            recorder.write([reading(n, time.time_ns()) for n in range(safe, safe + batch)])
            safe += batch
    except RecordingError as caught:
        error = str(caught)
    if reader is not None:
        reader.close()
    try:
        with Session(file) as session:
            rows = session.database.execute("SELECT seq FROM readings ORDER BY id").fetchall()
    except (RecordingError, sqlite3.Error) as caught:
        return {"unreadable": 1, "rows": 0, "why": str(caught)}  # pyright: ignore
    numbers = [seq for (seq,) in rows]
    return {
        "rows": len(numbers),
        "seen but lost": len(set(range(safe)) - set(numbers)),
        "duplicated": len(numbers) - len(set(numbers)),
        "unclear errors": int("the disk is full" not in error),
        "unreadable": 0,
    }


def fills(times: int) -> dict[str, float]:
    rig, chance = jt.load_rig("dual-cell"), random.Random(2)
    results = []
    for number in range(times):
        with tempfile.TemporaryDirectory() as folder:
            size = chance.randrange(300, 12_000)
            mount = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", folder]
            subprocess.run(mount, check=True)
            try:
                results.append(fill_once(Path(folder) / f"{number}.db", rig, chance))
            finally:
                subprocess.run(["umount", folder], check=True)
    keys = ("rows", "seen but lost", "duplicated", "unclear errors", "unreadable")
    return {"full disks": times, **{key: sum(r.get(key, 0) for r in results) for key in keys}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--full", type=int, default=20)
    options = parser.parse_args()
    assert threading.active_count() == 1, "a process with threads cannot be forked safely"
    if options.kills:
        print(json.dumps(kills(options.kills)), flush=True)
    if options.full:
        print(json.dumps(fills(options.full)), flush=True)


if __name__ == "__main__":
    main()
