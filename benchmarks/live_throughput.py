"""How much can one core record, and how long does it take from bytes to a prediction?

    python benchmarks/live_throughput.py --seconds 60

A sender of its own process writes 500 camera frames (80 x 60, 16 bits) and 1000 controller lines a
second to a TCP port on loopback. This process, on one core, receives, records (frames kept) and
steps the twin. Prints one line of JSON.
"""

import argparse
import json
import multiprocessing
import os
import resource
import socket
import tempfile
import time
from pathlib import Path

import numpy as np

import jaxtwin as jt
from jaxtwin.io import Session
from jaxtwin.live import (
    Data,
    Follower,
    Gap,
    Hello,
    Image,
    Reading,
    Recorder,
    RigState,
    Sample,
    connect,
    encode,
)
from jaxtwin.physics import Twin

TICK = 0.01  # s; the sender writes what is due since the last one
HELLO = Hello(2, "dual-cell", "bench", ("P1", "P2"), camera=(80, 60), watchdog=2.0)


def send(port_pipe, seconds: float, frame_rate: int, line_rate: int) -> None:
    """Sends for some seconds, and then says how many of each."""
    random = np.random.default_rng(0)
    pictures = [random.integers(29_500, 33_000, (60, 80), dtype=np.uint16) for _ in range(16)]
    with socket.create_server(("127.0.0.1", 0)) as server:
        port_pipe.send(server.getsockname()[1])
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(encode(HELLO))
        begin = time.monotonic()
        lines = frames = 0
        while (now := time.monotonic() - begin) < seconds:
            parts = []
            while lines < now * line_rate:
                pwm = (lines % 256, -(lines % 200))
                parts.append(encode(Data(lines, time.time_ns() // 1000, pwm, 16.0)))
                lines += 1
            while frames < now * frame_rate:
                parts.append(
                    encode(Image(frames, time.time_ns() // 1000, 0, pictures[frames % 16]))
                )
                frames += 1
            connection.sendall(b"".join(parts))
            time.sleep(max(0.0, begin + now + TICK - time.monotonic()))
        port_pipe.send((lines, frames))
        port_pipe.recv()  # until everything is read
        connection.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--lines", type=int, default=1000)
    parser.add_argument("--without-twin", action="store_true")
    options = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))
    # Before JAX starts its threads: they stay on this core too.
    os.sched_setaffinity(0, {cores[0]})

    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("fork")
    sender = context.Process(
        target=send, args=(theirs, options.seconds, options.frames, options.lines)
    )
    sender.start()
    os.sched_setaffinity(sender.pid or 0, {cores[-1]})
    rig = jt.load_rig("dual-cell")
    follower = None if options.without_twin else Follower(Twin(rig))
    state = RigState()
    waits = []  # from the read of the bytes to the prediction, ns
    counts = {"samples": 0, "readings": 0, "gaps": 0}
    sent, sent_at = None, 0.0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.db"
        url = f"socket://127.0.0.1:{ours.recv()}"
        with (
            Recorder(file, rig, keep_frames=True) as recorder,
            connect(rig, url, journal=recorder) as bench,
        ):
            begin_cpu = time.process_time()
            begin = time.monotonic()
            while sent is None or counts["samples"] + counts["readings"] < sum(sent):
                records = bench.poll()
                for record in records:
                    state = state.after(record)
                    if follower is not None:
                        follower.on_record(record, state)
                    if isinstance(record, Reading):
                        waits.append(bench.clock.now() - record.arrival)
                    counts["samples"] += isinstance(record, Sample)
                    counts["readings"] += isinstance(record, Reading)
                    counts["gaps"] += record.count if isinstance(record, Gap) else 0
                if sent is None and ours.poll():
                    sent = ours.recv()
                    sent_at = time.monotonic()
                if sent is not None and time.monotonic() - sent_at > 10:
                    break
            wall = time.monotonic() - begin
            cpu = time.process_time() - begin_cpu
        ours.send("done")
        sender.join()
        with Session(file) as session:
            kept = {
                table: session.database.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
                for table in ("samples", "readings", "frames")
            }
        size = file.stat().st_size
    median, most, worst = np.quantile(np.array(waits) * 1e-6, [0.5, 0.99, 1.0])
    result = {
        "seconds": round(wall, 1),
        "sent lines, frames": sent,
        "kept": kept,
        "lost": counts["gaps"],
        "core used": round(cpu / wall, 3),
        "bytes to prediction, ms (median, 99 %, worst)": [
            round(float(value), 2) for value in (median, most, worst)
        ],
        "file, MB": round(size / 1e6, 1),
        "peak memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "load average": os.getloadavg()[0],
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
