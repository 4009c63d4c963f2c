"""Do the cells go off in time, whatever goes wrong, and how hot did the plate really become?

    python benchmarks/live_hazards.py                     # make hazards: every hazard, 20 times
    python benchmarks/live_hazards.py --control --seeds 20
    python benchmarks/live_hazards.py --healthy 1000      # hours without a hazard
    python benchmarks/live_hazards.py --live 20           # the same, behind all interlocks

Each hazard of `tests/hazards.py` meets a driven virtual rig once a seed, which chooses noise, duty,
the moment, the pace of the host, the room (5 to 40 degC), whether it is measured, and how warm the
rig is at the start. The twin of the interlocks is that of a match to the paper's recordings of
steps, with draws of its posterior. The virtual rig is another draw for another day, except for the
camera, on whose readings the limits act. `drive` commands it by a schedule, or `control` by a PID
from a controller file, behind the same interlocks. The clock is simulated. After the end, rigs that
go on to heat, or do so again, must be found by their readings; those that are off must not be.

Prints a table: runs, off in time, the longest time, its bound, how far the plate was above its
limit at the worst, the reasons, and what was said in one of the runs.

Healthy hours have references of up to 60 % of the way from the room to the limit that change every
ten minutes. Counted is how many the interlock on the duty stops (`--healthy`), of those of which it
was said before that they are near the limit, and of the others; or (`--live`) how hours end that
run behind all interlocks in the time of the rig, and what the readings showed after the end.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from hand_clock import HandClock, stepped_bench
from hazards import (
    AFTER_STOP,
    HAZARDS,
    HIDDEN_KELVIN,
    run_after_stop,
    run_hazard,
    save_pid,
)

import jaxtwin as jt
from jaxtwin.control import LiveLoop, control, read_controller
from jaxtwin.errors import SafetyStop
from jaxtwin.live import Ending, Guard, InProcess, OperatingLimits, VirtualRig
from jaxtwin.matching import posterior_draws
from jaxtwin.rig import Sensors

CAMERA = {"d_x", "d_y", "s_view", "r_view", "g_TAM", "g_TBM", "g_TCM"}
CAMERA |= {f"g_T{row}{end}" for row in (1, 2) for end in range(1, 7)}
"""Parameters of the camera's view and of its channels."""

DRAWS = 32
MAX_SEEDS = 2000
FIRST_HOUR = 2000
REACH = 0.6
"""The largest reference of a healthy hour, as a part of the way from the room to the limit."""

MAX_RISE = 14.0
"""The largest rise of the references above the room, which each draw of the rig can hold, K."""

LIMIT = 55.0
"""The limit of the rig in healthy hours, degC."""


class Bench:
    """The twins of the interlocks, their draws, and the true rigs; the same in each process."""

    def __init__(self) -> None:
        rig = jt.load_rig("dual-cell")
        fit = jt.match(jt.Twin(rig), [jt.read_recording(path) for path in jt.find_recordings()])
        self.values = dict(fit.mean_twin.values)
        sensors = replace(rig, camera=None, sensors=Sensors(0.1))
        self.twins = jt.Twin(rig, self.values), jt.Twin(sensors, self.values)
        limits = replace(sensors.limits, temperature=LIMIT + 273.15)  # pyright: ignore
        self.low = jt.Twin(replace(sensors, limits=limits), self.values)
        known = posterior_draws(fit, DRAWS)
        self.draws = {name: column for name, column in known.items() if name not in CAMERA}
        self.true = posterior_draws(fit, MAX_SEEDS, seed=1)
        self.folder = tempfile.TemporaryDirectory()
        self.controller = save_pid(Path(self.folder.name) / "pid.toml", self.twins[0])
        # Half of the time of a run; they are the same in all runs of a twin.
        of, known_limits = OperatingLimits.of, {}

        def limits_of(twin: jt.Twin) -> OperatingLimits:
            return known_limits.setdefault(twin.rig.fingerprint + str(twin.rig.limits), of(twin))

        OperatingLimits.of = limits_of  # pyright: ignore[reportAttributeAccessIssue]

    def truth(self, seed: int) -> dict[str, float]:
        """The values of a true rig."""
        return {
            name: float(column[seed % MAX_SEEDS])
            for name, column in self.true.items()
            if name not in CAMERA
        }


bench = cache(Bench)


def hazard_row(number: int, seeds: int, by_controller: bool) -> list[str]:
    """The row of a hazard."""
    b, hazard = bench(), HAZARDS[number]
    runs = [
        run_hazard(
            hazard, b.twins, seed, b.controller if by_controller else None, b.truth(seed), b.draws
        )
        for seed in range(seeds)
    ]
    in_time = sum(run.off_after <= hazard.bound for run in runs)
    bound = f"{hazard.bound:g} s" if hazard.bound else f"never {HIDDEN_KELVIN:g} K above the limit"
    said = next((run.detail for run in runs if run.detail), "")
    return [
        hazard.name,
        str(len(runs)),
        str(in_time),
        f"{max(run.off_after for run in runs):.2f} s",
        bound,
        f"{max(run.hottest - run.limit for run in runs):+.1f} K",
        _counted(run.reason for run in runs),
        said.removeprefix("stopped: "),
    ]


def after_stop_row(number: int, seeds: int) -> list[str]:
    """The row of a rig after the end of a run."""
    b, case = bench(), AFTER_STOP[number]
    runs = [run_after_stop(case, b.twins, seed, b.truth(seed), b.draws) for seed in range(seeds)]
    right = sum(run.verdict in case.verdicts for run in runs)
    times = [run.after for run in runs if run.verdict in ("off", "heats")]
    said = next((run.said for run in runs if run.verdict in case.verdicts), runs[0].said)
    return [
        case.name,
        str(len(runs)),
        str(right),
        f"{max(times, default=0.0):.0f} s",
        "60 s",
        f"{max(run.hottest - run.limit for run in runs):+.1f} K",
        _counted(run.verdict for run in runs),
        said,
    ]


class Hour(NamedTuple):
    """An hour without a hazard.

    - `ended`: what ended it, as the interlocks decide by the duty; "refused" before it began.
    - `sigmas`: how far from the limit the twin expects the hottest part, in standard deviations.
    - `is_near`: whether it was said before it began that a healthy rig may be stopped.
    """

    ended: str
    sigmas: float = 0.0
    is_near: bool = True


def healthy_hour(seed: int) -> Hour:
    """An hour of a rig on which nothing is wrong, in the loop that its controller makes with it, as
    `HiddenHeat` judges it. References change every ten minutes, up to `REACH` of the way."""
    b, room, references = bench(), *_references(seed)
    guard = Guard.of(b.low, ambient=room, draws=b.draws)
    pid = read_controller(b.controller, b.low.rig)
    real = jt.Twin(b.low.rig, {**b.values, **b.truth(seed), "T_amb": room, "T_start": room})
    try:
        plans = [
            LiveLoop(twin, pid, references, duration=3600, ambient=room).simulated_plan()
            for twin in (b.low, real)
        ]
        hottest = guard.check_plan(plans[0])
    except jt.JaxtwinError:
        return Hour("refused")
    assert hottest is not None
    try:
        guard.check_plan(plans[1])
    except jt.JaxtwinError:
        return Hour("stopped", hottest.sigmas, hottest.is_near)
    return Hour("completed", hottest.sigmas, hottest.is_near)


def live_hour(seed: int) -> tuple[str, str]:
    """As `healthy_hour`, of a virtual rig behind all interlocks: how it ended, and what the
    readings showed after the end."""
    b, room, references = bench(), *_references(seed)
    real = jt.Twin(b.low.rig, {**b.values, **b.truth(seed), "T_amb": room, "T_start": room})
    device = VirtualRig(real, seed=seed, controller_rate=1)
    device.twin.start(0.0, room)
    clock, ends = HandClock(), list[Ending]()
    guard = Guard.of(b.low, ambient=room, draws=b.draws)
    try:
        ended = control(
            stepped_bench(b.low.rig, {"rig": lambda: InProcess(device, clock)}, clock, step=0.5),
            guard,
            LiveLoop(
                b.low,
                read_controller(b.controller, b.low.rig),
                references,
                duration=3600,
                ambient=room,
            ),
            on_end=ends.append,
        )
    except (SafetyStop, jt.JaxtwinError) as stop:
        ended = str(stop)
    return ended, ends[-1].verdict if ends else "not started"


def _references(seed: int) -> tuple[float, str]:
    """The room of an hour and its references, degC."""
    random = np.random.default_rng(seed)
    room = float(random.uniform(5, 40))
    # What no duty reaches is refused anyway.
    steps = room + min(LIMIT - room, MAX_RISE / REACH) * random.uniform(0.1, REACH, 6)
    return room, ",".join(f"{600 * n}:{step:.1f}" for n, step in enumerate(steps))


def _counted(words: Any) -> str:
    counts = Counter(words).most_common()
    return ", ".join(f"{word} {count}" if len(counts) > 1 else word for word, count in counts)


def compute(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """The results of tasks, on all processors."""
    processes = os.cpu_count() or 1
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        waiting = [pool.apply_async(task) for task in tasks]
        return [each.get() for each in waiting]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first hazard")
    parser.add_argument("--last", type=int, default=len(HAZARDS))
    parser.add_argument("--healthy", type=int, default=0, help="hours, in place of hazards")
    parser.add_argument("--live", type=int, default=0, help="such hours, behind all interlocks")
    parser.add_argument("--control", action="store_true", help="by a controller, not a schedule")
    parser.add_argument("--out", type=Path, help="a file for the table, .md")
    options = parser.parse_args()
    begin = time.time()
    bench()  # its compiled programs are kept for the processes
    seeds = range(FIRST_HOUR, FIRST_HOUR + max(options.healthy, options.live))
    if options.live:
        ended, shown = zip(*compute([partial(live_hour, seed) for seed in seeds]), strict=True)
        counts = {"hours": len(ended), "ended": Counter(ended), "after": Counter(shown)}
        lines = [json.dumps(counts)]
    elif options.healthy:
        hours = compute([partial(healthy_hour, seed) for seed in seeds])
        table = Counter((hour.is_near, hour.ended) for hour in hours if hour.ended != "refused")
        refused = sum(hour.ended == "refused" for hour in hours)
        lines = [
            f"hours {'near' if near else 'not near'} the limit: {table[near, 'completed']} "
            f"completed, {table[near, 'stopped']} stopped"
            for near in (False, True)
        ]
        lines.append(f"refused before they began: {refused}")
    else:
        tasks = [
            partial(hazard_row, number, options.seeds, options.control)
            for number in range(options.first, options.last)
        ]
        if not options.control:
            numbers = range(len(AFTER_STOP))
            tasks += [partial(after_stop_row, number, options.seeds) for number in numbers]
        head = ["hazard", "runs", "as it must", "longest", "bound", "plate above its limit"]
        table = [[*head, "ended by", "said, in one run"], ["---"] * 8, *compute(tasks)]
        lines = [f"| {' | '.join(row)} |" for row in table]
    lines.append(f"\n{time.time() - begin:.0f} s on {os.cpu_count()} processors")
    print("\n".join(lines))
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
