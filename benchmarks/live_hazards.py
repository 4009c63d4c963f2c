"""Do the cells go off in time, whatever goes wrong?

    python benchmarks/live_hazards.py --seeds 25
    python benchmarks/live_hazards.py --seeds 25 --control

Each hazard of `tests/hazards.py` meets a driven virtual rig once a seed, which chooses noise, duty,
the moment, the pace of the host, the room (5 to 40 degC), whether it is measured, and how warm the
rig is at the start. The twin of the interlocks is that of a match to the paper's recordings of
steps. The virtual rig is a draw from its posterior for another day, except for the camera, on whose
readings the limits act. `drive` commands it by a schedule, or `control` by a PID from a controller
file, behind the same interlocks. The clock is simulated. Healthy runs with noise, jumps of the
camera, lost and damaged messages say how often a drive is stopped for nothing. Prints one line a
hazard: runs, off in time, the longest time, its bound, and the reasons.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from hand_clock import HandClock, virtual_bench
from hazards import HAZARDS, run_hazard, save_pid

import jaxtwin as jt
from jaxtwin._errors import SafetyStop
from jaxtwin.live import Guard, OperatingLimits, VirtualRig, drive
from jaxtwin.matching import posterior_draws
from jaxtwin.physics import Faults
from jaxtwin.rig import Sensors

CAMERA = {"d_x", "d_y", "s_view", "r_view", "g_TAM", "g_TBM", "g_TCM"}
CAMERA |= {f"g_T{row}{end}" for row in (1, 2) for end in range(1, 7)}
"""Parameters of the camera's view and of its channels."""


def healthy(twin: jt.Twin, truth: dict[str, float], seed: int) -> str:
    """Five minutes of a rig on which nothing is wrong that a bench does not have; how it ended."""
    faults = Faults.parse("drop=0.02,corrupt=0.01,jumps=30")
    room = float(np.random.default_rng(seed).uniform(5, 40))
    real = jt.Twin(twin.rig, {**twin.values, **truth, "T_amb": room, "T_start": room})
    device, clock = VirtualRig(real, seed=seed, faults=faults), HandClock()
    plan = jt.Experiment.schedule("0:0.8,100:-0.5/0.6,200:0.3", duration=300, cells=2)
    try:
        return drive(virtual_bench(twin.rig, device, clock), Guard.of(twin), plan)
    except SafetyStop as stop:
        return str(stop)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=25)
    parser.add_argument("--first", type=int, default=0, help="number of the first hazard")
    parser.add_argument("--last", type=int, default=len(HAZARDS))
    parser.add_argument("--healthy", type=int, default=0, help="runs")
    parser.add_argument("--control", action="store_true", help="by a controller, not a schedule")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        compute(options, Path(folder))
    print(json.dumps({"CPU time, s": round(time.process_time())}))


def compute(options: argparse.Namespace, folder: Path) -> None:
    """All runs; `folder` is for the controller's file."""
    rig = jt.load_rig("dual-cell")
    fit = jt.match(jt.Twin(rig), [jt.read_recording(path) for path in jt.find_recordings()])
    values = dict(fit.mean_twin.values)
    twins = jt.Twin(rig, values), jt.Twin(replace(rig, camera=None, sensors=Sensors(0.1)), values)
    drawn = posterior_draws(fit, max(options.seeds, options.healthy))
    truths = [
        {name: float(column[seed]) for name, column in drawn.items() if name not in CAMERA}
        for seed in range(max(options.seeds, options.healthy))
    ]
    controller = save_pid(folder / "pid.toml", twins[0]) if options.control else None
    # Half of the time of a run; they are the same in all runs of a twin.
    known = {id(twin): OperatingLimits.of(twin) for twin in twins}
    of = OperatingLimits.of
    for hazard in HAZARDS[options.first : options.last]:
        with patch.object(OperatingLimits, "of", lambda twin: known.get(id(twin)) or of(twin)):
            runs = [
                run_hazard(hazard, twins, seed, controller, truths[seed])
                for seed in range(options.seeds)
            ]
        unexplained = [ran.detail or ran.reason for ran in runs if ran.reason not in hazard.kinds]
        result = {
            "hazard": hazard.name,
            "runs": len(runs),
            "off in time": sum(ran.off_after <= hazard.bound for ran in runs),
            "longest, s": round(max(ran.off_after for ran in runs), 2),
            "bound, s": hazard.bound,
            "reasons": Counter(ran.reason for ran in runs),
            "unexplained": unexplained,
        }
        print(json.dumps(result), flush=True)
    if options.healthy:
        ended = Counter(healthy(twins[0], truths[seed], seed) for seed in range(options.healthy))
        print(json.dumps({"healthy": options.healthy, "ended": ended}))


if __name__ == "__main__":
    main()
