"""What is lost, duplicated or wrongly accepted on a bad link?

    python benchmarks/live_losses.py --disconnects 1000 --corrupted 1000000

Part 1: a device behind a real socket is cut off again and again, in the middle of messages too.
Part 2: bytes of a stream are changed, dropped or inserted at random before a receiver gets them.
Every accepted message is compared with what was sent under its number. Prints JSON.
"""

import argparse
import json
import random
import socket
import tempfile
import threading
from pathlib import Path

import numpy as np

import jaxtwin as jt
from jaxtwin.io import Session as Recording
from jaxtwin.live import (
    Data,
    Gap,
    Hello,
    Image,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Recorder,
    Sample,
    connect,
    encode,
)
from jaxtwin.live.protocol import _link
from jaxtwin.live.protocol._identity import Identity
from jaxtwin.live.protocol._link import Arrived
from jaxtwin.live.protocol._receiver import Receiver

HELLO = Hello(2, "dual-cell", "bench", ("P1", "P2"), camera=(80, 60), watchdog=2.0)
FRAME_EVERY = 20  # messages; an image among so many lines


def pwm(seq: int) -> tuple[int, int]:
    """Counts that a sample must have, by its number."""
    return (seq * 7919 % 511 - 255, seq * 104_729 % 511 - 255)


def pixel(seq: int) -> int:
    """Value of all pixels that an image must have, by its number."""
    return 28_000 + seq * 7919 % 6000


def message(number: int) -> bytes:
    """The device's message with this number, all streams together."""
    if number % FRAME_EVERY == 0:
        seq = number // FRAME_EVERY
        return encode(Image(seq, number * 100, 0, np.full((60, 80), pixel(seq), np.uint16)))
    seq = number - number // FRAME_EVERY - 1
    return encode(Data(seq, number * 100, pwm(seq), 16.0))


class Tally:
    """Compares what came with what was sent."""

    def __init__(self) -> None:
        self.accepted = self.wrong = self.duplicated = self.lost = 0
        self.seen: dict[str, set[int]] = {"data": set(), "image": set()}

    def take(self, records: list[Record]) -> None:
        for record in records:
            if isinstance(record, Gap):
                self.lost += record.count
            elif isinstance(record, Sample):
                self._count("data", record.seq, record.pwm == pwm(record.seq))
            elif isinstance(record, Reading):
                right = abs(record.temperatures[0] - (pixel(record.seq) / 100 - 273.15)) < 1e-6
                self._count("image", record.seq, bool(right))

    def _count(self, stream: str, seq: int, right: bool) -> None:
        self.accepted += 1
        self.wrong += not right
        self.duplicated += seq in self.seen[stream]
        self.seen[stream].add(seq)

    def unexplained(self) -> int:
        """Numbers between the first and the last that were neither seen nor reported as lost."""
        spans = sum(max(s) - min(s) + 1 - len(s) for s in self.seen.values() if s)
        return spans - self.lost

    def result(self) -> dict[str, int]:
        return {
            "accepted": self.accepted,
            "lost, reported as gaps": self.lost,
            "lost, not reported": self.unexplained(),
            "duplicated": self.duplicated,
            "wrongly accepted": self.wrong,
        }


def disconnects(times: int) -> dict[str, int]:
    """Part 1. The device goes on counting while nobody is connected, and repeats a little."""
    rig = jt.load_rig("dual-cell")
    _link.STABLE_SECONDS = (
        0.0  # else a device that hangs up so soon would be asked less and less often
    )
    chance = random.Random(1)
    server = socket.create_server(("127.0.0.1", 0))
    done = threading.Event()

    def device() -> None:
        number = 0
        for _ in range(times):
            connection, _ = server.accept()
            stream = encode(HELLO)
            # A device may send again what it cannot know to have arrived: the last messages.
            first = max(0, number - chance.randrange(5))
            number += chance.randrange(10, 60)
            stream += b"".join(message(n) for n in range(first, number))
            cut = len(stream) - chance.choice([0, 0, chance.randrange(100)])
            connection.sendall(stream[:cut])
            connection.close()
            number += chance.choice([0, 0, 3])  # nobody listens
        done.set()

    thread = threading.Thread(target=device)
    thread.start()
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.db"
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        cuts = 0
        with Recorder(file, rig) as recorder, connect(rig, url, journal=recorder) as bench:
            while not done.is_set() or cuts < times:
                records = bench.poll()
                cuts += sum(
                    isinstance(r, LinkChange) and r.state is LinkState.DOWN for r in records
                )
                tally.take(records)
        thread.join()
        server.close()
        with Recording(file) as recording:
            execute = recording.database.execute
            rows = execute("SELECT count(*), count(DISTINCT seq) FROM samples").fetchone()
            images = execute("SELECT count(*), count(DISTINCT seq) FROM readings").fetchone()
    assert rows[0] + images[0] == tally.accepted, "the recording holds what was seen"
    return {"disconnects": cuts, **tally.result()}


def corruption(changes: int) -> dict[str, int]:
    """Part 2: one change in about 200 bytes, in chunks of random length."""
    rig = jt.load_rig("dual-cell")
    receiver = Receiver("link", Identity.of(rig))
    chance = np.random.default_rng(2)
    arrival = 1_700_000_000_000_000_000
    receiver.changed(LinkChange("link", arrival, LinkState.CONNECTING, ""))
    receiver.receive(Arrived("link", arrival, encode(HELLO)))
    tally = Tally()
    made = number = 0
    longest = 0
    while made < changes:
        stream = b"".join(message(n) for n in range(number, number + 200))
        number += 200
        damaged = bytearray(stream)
        count = len(stream) // 200
        places = np.sort(chance.choice(len(stream), count, replace=False))[::-1]
        for place in places:  # from the end, so that the places before stay what they are
            kind = chance.integers(10)
            if kind == 0:
                del damaged[place]
            elif kind == 1:
                damaged.insert(place, int(chance.integers(256)))
            else:
                damaged[place] ^= int(chance.integers(1, 256))
        made += count
        begin = 0
        while begin < len(damaged):
            end = begin + int(chance.integers(1, 20_000))
            arrival += 10_000_000
            tally.take(receiver.receive(Arrived("link", arrival, bytes(damaged[begin:end]))))
            longest = max(longest, len(receiver._rest))
            begin = end
        assert receiver.verdict is None or "without a valid" in receiver.verdict
        receiver.verdict = None  # go on with it all the same
    return {"bytes changed": made, **tally.result(), "most bytes waiting": longest}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--disconnects", type=int, default=1000)
    parser.add_argument("--corrupted", type=int, default=1_000_000)
    options = parser.parse_args()
    print(json.dumps({"corruption": corruption(options.corrupted)}), flush=True)
    print(json.dumps({"disconnects": disconnects(options.disconnects)}), flush=True)


if __name__ == "__main__":
    main()
