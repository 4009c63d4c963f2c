"""What does a page cost, and what does it lose? Fifty browsers on a virtual rig of 15 channels.

The rig runs ten times as fast as a real one. Each client is a socket that reads the
stream as a browser does; one of them reads too slowly, one not at all. Measured are the records in
the recording against those that the device made, the processor time and the memory of the server,
the time of opening with a week of history, and the time until a client that was connected gets
frames again after the server was killed and started anew.

    python -m benchmarks.serve [--seconds 120] [--clients 50] [--speed 10]
"""

import argparse
import contextlib
import json
import os
import re
import selectors
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np
import psutil

from benchmarks._machine import processor
from jaxtwin.io import Session
from jaxtwin.live import report
from jaxtwin.serve import History

RIG, PORT = "dual-cell", 8640
WEEK = 7 * 86_400.0
START_SECONDS = 120.0


def device(speed: float) -> tuple[subprocess.Popen[str], str]:
    """A virtual rig with 10 frames and 10 samples a second."""
    command = [sys.executable, "-m", "jaxtwin", "virtual-rig", RIG, "--port", "7640"]
    command += ["--speed", str(speed), "--camera-rate", "10"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    found = re.search(r"socket://\S+:\d+", process.stdout.readline())
    assert found is not None
    return process, found[0]


def started(url: str, file: Path) -> subprocess.Popen[str]:
    """A server that begins."""
    command = [sys.executable, "-m", "jaxtwin", "serve", RIG, "--link", url, "--port", str(PORT)]
    command += ["--out", str(file)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def server(url: str, file: Path) -> subprocess.Popen[str]:
    """A server that answers."""
    process = started(url, file)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def connected() -> socket.socket:
    client = socket.create_connection(("127.0.0.1", PORT))
    client.sendall(f"GET /events HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n\r\n".encode())
    client.setblocking(False)
    return client


def watched(process: subprocess.Popen[str], clients: int, seconds: float) -> dict[str, float]:
    """Lets clients read, and measures the server meanwhile."""
    selector = selectors.DefaultSelector()
    opened = [connected() for _ in range(clients)]
    for client in opened[2:]:  # the first never reads, the second a little
        selector.register(client, selectors.EVENT_READ)
    seen = psutil.Process(process.pid)
    begin, read, lines = time.monotonic(), 0, 0
    used, memory = sum(seen.cpu_times()[:2]), []
    looked = begin
    while time.monotonic() - begin < seconds:
        for key, _ in selector.select(0.2):
            data = key.fileobj.recv(65_536)  # pyright: ignore[reportAttributeAccessIssue]
            read += len(data)
            lines += data.count(b"event: sample")
        if time.monotonic() - looked > 1.0:
            looked = time.monotonic()
            memory.append(seen.memory_info().rss / 1e6)
            with contextlib.suppress(BlockingIOError):
                opened[1].recv(200)
    used = sum(seen.cpu_times()[:2]) - used
    for client in opened:
        client.close()
    half = len(memory) // 2
    return {
        "cpu_percent": 100 * used / seconds,
        "memory_mb": memory[-1],
        "memory_growth_mb": float(np.median(memory[half:]) - np.median(memory[:half])),
        "frames_per_second": lines / seconds / (clients - 2),
        "bytes_per_second_and_client": read / seconds / (clients - 2),
    }


def opening() -> float:
    """The time of an answer with a week of history, s: of the history alone, in this process."""
    history, random = History(15, 2), np.random.default_rng(0)
    for at in np.arange(0.0, WEEK, 20.0):
        values = random.normal(30.0, 1.0, 15)
        history.add(1.7e9 + at, values, values, values, np.zeros(2))
    begin = time.perf_counter()
    text = json.dumps(history.over(WEEK))
    taken = time.perf_counter() - begin
    print(f"a week: {len(text) / 1e3:.0f} kB")
    return taken


def resumed(url: str, file: Path, killed: subprocess.Popen[str]) -> float:
    """Kills the server and starts it anew. Returns the time until a client that tries once in a
    second, as the page does, has a new reading, s."""
    killed.kill()
    killed.wait()
    begin = time.monotonic()
    process = started(url, file)
    while True:
        with contextlib.suppress(OSError, StopIteration):
            address = f"http://127.0.0.1:{PORT}/events?after=earlier-5"
            with urllib.request.urlopen(address, timeout=20) as answer:
                next(line for line in answer if line.startswith(b"event: sample"))
                break
        time.sleep(1.0)
    found = time.monotonic() - begin
    process.terminate()
    process.wait()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--speed", type=float, default=10.0)
    options = parser.parse_args()
    print(f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    rig, url = device(options.speed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.db"
        serving = server(url, file)
        try:
            time.sleep(5.0)
            alone = watched(serving, 3, options.seconds / 4)
            found = watched(serving, options.clients, options.seconds)
            again = resumed(url, file, serving)
        finally:
            rig.terminate()
            rig.wait()
        with Session(file) as session:
            told = report(session)
    for name, value in found.items():
        print(f"{name}: {value:.1f} with {options.clients} clients, {alone[name]:.1f} with 3")
    for stream in told["streams"]:
        print(f"{stream['stream']}: {stream['count']} recorded")
    print(f"lost: {told['lost'] or 0}; events: {told['events']}")
    print(f"opened with a week of history: {opening():.3f} s")
    print(f"killed and started: a client has readings again after {again:.1f} s")


if __name__ == "__main__":
    main()
