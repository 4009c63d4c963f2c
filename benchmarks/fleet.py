"""What does a fleet cost, what does it lose, and does it find the same as a monitor of one rig?

A process publishes virtual rigs to mosquitto; another one watches them as `jaxtwin fleet` does.
Measured are the processor time of the second, by its own clock; its memory, and how it grows; the
readings that the broker was given against those that were used; and the findings on a rig whose
contact comes loose, against those of a `LiveMonitor` that gets the same messages.

    python -m benchmarks.fleet [--rig dual-cell] [--rigs 500] [--speed 1] [--minutes 10]
"""

import argparse
import json
import multiprocessing
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import psutil

from benchmarks._machine import processor
from jaxtwin.fleet import Fleet, FleetFile, VirtualFleet
from jaxtwin.live import Finding, Reading, RigState, Sample, counts_of
from jaxtwin.monitoring import LiveMonitor
from jaxtwin.physics import Faults

FAULTY = "rig-0007"
FAULT_SECONDS = 300.0
FAULT = "loosen=P1"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rig", default="dual-cell")
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        config = folder / "mosquitto.conf"
        config.write_text(
            f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
        )
        program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        quiet = subprocess.DEVNULL
        broker = subprocess.Popen([program, "-c", str(config)], stdout=quiet, stderr=quiet)
        time.sleep(1)
        try:
            measure(folder, port, options)
        finally:
            broker.terminate()


def measure(folder: Path, port: int, options: argparse.Namespace) -> None:
    """Runs the fleet and prints what it costs."""
    process = psutil.Process()
    few = Fleet(fleet_file(folder, port, options.rig, 1, "few"))  # compiles
    few.close()
    base = process.memory_info().rss
    path = fleet_file(folder, port, options.rig, options.rigs, "fleet")
    begin = time.monotonic()
    told: list[tuple[str, Finding]] = []
    fleet = Fleet(path, lambda alarm, rig: told.append((rig, alarm)))
    start = time.monotonic() - begin
    fleet.turn()  # subscribes
    while not fleet.is_connected:
        fleet.turn()
    fleet.turn()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    publisher = context.Process(target=publish, args=(theirs, path, options), daemon=True)
    publisher.start()
    begin, cpu, rows = time.monotonic(), time.process_time(), []
    rss = [process.memory_info().rss]
    sent, is_told, ended = 0, False, None
    while ended is None or time.monotonic() - ended < 8:
        fleet.turn()
        if ours.poll():
            message = ours.recv()
            if not is_told:  # the first reading goes out
                is_told, begin, cpu = True, time.monotonic(), time.process_time()
            else:
                sent, ended = message, ended or time.monotonic()
        now = time.monotonic()
        if is_told and now - begin >= 60 and ended is None:
            share = (time.process_time() - cpu) / (now - begin)
            rss.append(process.memory_info().rss)
            rows.append((share, rss[-1], os.getloadavg()[0]))
            used = sum(rig.queue.counts["used"] for rig in fleet.rigs.values())
            print(f"{100 * share:.1f} % of a core, {rss[-1] / 1e6:.0f} MB, {used} used", flush=True)
            begin, cpu = now, time.process_time()
    count = fleet._journal._all("SELECT count(*) FROM messages WHERE kind = 'readings'")[0][0]
    counts = sum((rig.queue.counts for rig in fleet.rigs.values()), start=Counter())
    half = rss[len(rss) // 2]
    alone = sorted(findings_alone(fleet))
    together = sorted(  # of the journal, as a rig keeps only its last findings in memory
        (row["kind"], row["channel"], round(1e3 * row["since"]), round(1e3 * row["found"]))
        for row in fleet.findings(FAULTY, 10**6)
    )
    size = (folder / "fleet.db").stat().st_size
    print(
        json.dumps(
            {
                "machine": processor(),
                "rig": options.rig,
                "rigs": options.rigs,
                "speed": options.speed,
                "minutes": len(rows),
                "start_s": round(start, 1),
                "share_percent": [round(100 * row[0], 1) for row in rows],
                "load": [round(row[2], 1) for row in rows],
                "rss_MB": [round(one / 1e6) for one in rss],
                "MB_a_rig": round((rss[-1] - base) / 1e6 / options.rigs, 3),
                "growth_of_second_half_MB": round((rss[-1] - half) / 1e6, 1),
                "sent": sent,
                "journal": count,
                "counts": dict(counts),
                "journal_MB": round(size / 1e6, 1),
                "finds_as_alone": together == alone,
                "findings": together,
                "alone": alone,
                "alarms_of_others": sorted({rig for rig, _ in told if rig not in ("", FAULTY)}),
            },
            indent=1,
        )
    )
    fleet.close()
    publisher.join()


def fleet_file(folder: Path, port: int, rig: str, rigs: int, name: str) -> Path:
    """The file of a fleet."""
    path = folder / f"{name}.toml"
    path.write_text(
        f'format = 1\nbroker = "mqtt://127.0.0.1:{port}/{name}"\njournal = "{name}.db"\n'
        f'[groups.all]\nrig = "{rig}"\nmembers = ["rig-{{0001..{rigs:04d}}}"]\n'
    )
    return path


def publish(pipe: Connection, path: Path, options: argparse.Namespace) -> None:
    """Publishes for some minutes, and tells how many readings."""
    fault = f"{FAULT}@{FAULT_SECONDS * options.speed**0.5:g}/4"
    virtual = VirtualFleet(FleetFile.read(path), {FAULTY: Faults.parse(fault)})
    pipe.send("ready")
    end = time.monotonic() + 60 * options.minutes + 5
    virtual.run(options.speed, lambda: time.monotonic() > end)
    virtual.close()
    pipe.send(virtual.sent)


def findings_alone(fleet: Fleet) -> list[tuple[str, str, int, int]]:
    """What a monitor of its own finds in the messages of the faulty rig."""
    rig = fleet.rigs[FAULTY]
    watching = LiveMonitor(rig.made.watcher[0], lambda finding: None)
    state = RigState()
    for number, message in enumerate(fleet._journal.after(FAULTY, 0, 10**9)):
        sample = rig.queue.parsed(message.kind, message.payload)
        assert sample is not None
        at, since = sample.time, sample.time // 1000
        if sample.duty is not None:
            ambient = None if np.isnan(sample.ambient) else sample.ambient
            counts = counts_of(rig.made.twin.rig, sample.duty)
            record = Sample("rig", "b", at, since, number, counts, ambient)
        else:
            record = Reading("rig", "b", at, since, number, sample.readings, False, None)
        state = state.after(record)
        watching.on_record(record, state)
    return [key(one) for one in watching.findings]


def key(finding: Finding) -> tuple[str, str, int, int]:
    """What tells one finding from another, with its times in ms."""
    return (
        finding.kind,
        finding.channel,
        round((finding.since or 0) / 1e6),
        round((finding.found or 0) / 1e6),
    )


if __name__ == "__main__":
    main()
