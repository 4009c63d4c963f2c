"""What does a twin in step with its rig cost?

    python benchmarks/live_twin.py --seconds 60

Predicts 15 channels for each of 9 frames a second, as `watch` does, for some seconds of the rig,
one call after the other on one core, and compares the time with that of the rig. Prints JSON.
"""

import argparse
import json
import os
import time

import numpy as np

import jaxtwin as jt
from jaxtwin.live import Plant
from jaxtwin.physics import Twin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of this computer")
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for name in ("dual-cell", "paper-2024"):
        live = Plant(Twin(jt.load_rig(name)))
        live.drive(np.array([0.5, 0.78]))
        frames, begin, cpu = 0, time.monotonic(), time.process_time()
        while time.monotonic() - begin < options.seconds:
            for _ in range(100):
                frames += 1
                live.advance(frames / 9)
        share = (time.process_time() - cpu) / (frames / 9)
        result = {
            "rig": name,
            "channels": len(live.temperatures),
            "rig seconds": round(frames / 9),
            "computer seconds": round(time.monotonic() - begin, 1),
            "share of one core in real time, %": round(100 * share, 3),
        }
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
