"""Draws a second against the number of draws, memory of a million draws, threads.

python -m benchmarks.scaling --quick
"""

import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import jaxtwin as jt

from ._measure import in_fresh_process, median_ratio, rounds, run_alone
from ._task import PUBLISHED

THOUSAND, MILLION = 1000, 1_000_000
PATIENCE = 400.0
"""Seconds that the largest number of draws may take, else it is left out."""
REDUCTIONS = ("cost", "final")
PEERS = {
    "CasADi CVODES": [100, 1000, 3000],
    "diffrax, vmapped": [100, 1000],
    "scipy LSODA": [30, 100],
}
"""Tool -> numbers of draws, with the setting that the search of `benchmarks.ways` finds best."""


def measure(quick: bool = False) -> dict[str, Any]:
    """On `paper-2024` around the published values.

    **Returns:** `times`: way -> pairs (draws, seconds), whole trajectories where nothing else is
    said; `against_thousands`: of costs and final temperatures in float64, pairs (draws, wall time
    over that of calls of a thousand), see `ours`; `flatness`: the largest of these ratios, and 1,
    over the smallest; `cpu_flatness`: the same of the CPU time, which does not see what else the
    machine does; `peak_MiB`: resident memory of a fresh process with its largest number of draws;
    `workers`: wall and CPU seconds of 1 and 2 threads and their ratio.
    """
    largest = 10_000 if quick else MILLION
    counts = [count for count in (100, 1000, 10_000, 100_000, MILLION) if count <= largest]
    double = in_fresh_process("scaling:ours", counts, "float64", REDUCTIONS)
    single = in_fresh_process("scaling:ours", counts[:4], "float32", REDUCTIONS)
    whole = in_fresh_process("scaling:ours", counts[:3], "float64", None)
    times = {
        "jaxtwin, float64, cost and final": double["times"],
        "jaxtwin, float32, cost and final": single["times"],
        "jaxtwin, float64": whole["times"],
    }
    for tool, sizes in PEERS.items():
        name, points = _peer(tool, sizes[:1] if quick else sizes, quick)
        times[name] = points
    return {
        "times": times,
        "against_thousands": double["wall"],
        "flatness": _flatness(double["wall"]),
        "cpu_flatness": _flatness(double["cpu"]),
        "peak_MiB": double["peak_MiB"],
        "peak_draws": double["times"][-1][0],
        "workers": workers(2000 if quick else 20_000, 1 if quick else 3),
    }


def _flatness(ratios: list[tuple[int, float]]) -> float:
    each = [1.0, *(ratio for _, ratio in ratios)]
    return max(each) / min(each)


def ours(counts: list[int], precision: Any, reductions: Any) -> dict[str, Any]:
    """Times and peak memory of the batch engine, from few draws to many.

    A machine that others share slows down under a load of minutes. So many draws are compared with
    the same draws in calls of a thousand, half of them made before and half after.

    **Returns:** `times`: pairs (draws, seconds); `wall`, `cpu`: pairs (draws, time over that of
    calls of a thousand); `peak_MiB`.
    """
    twin, experiment = PUBLISHED.twin, PUBLISHED.experiment

    def seconds(draws: dict[str, Any]) -> tuple[float, float]:
        began, busy = time.perf_counter(), time.process_time()
        jt.reduce_batch(twin, experiment, draws, reductions, precision=precision)
        return time.perf_counter() - began, time.process_time() - busy

    times, wall, cpu = [], [], []
    for count in counts:
        if times and times[-1][1] / times[-1][0] * count > PATIENCE:
            break
        draws = PUBLISHED.draws(count)
        if count <= THOUSAND:
            seconds(draws)  # the first call compiles
            times.append((count, median(seconds(draws)[0] for _ in range(9))))
            continue
        parts = [
            {name: values[first : first + THOUSAND] for name, values in draws.items()}
            for first in range(0, count, THOUSAND)
        ]
        taken, ratios = [], []
        for _ in range(max(1, 100_000 // count)):
            before = [seconds(part) for part in parts[: len(parts) // 2]]
            whole = seconds(draws)
            after = [seconds(part) for part in parts[len(parts) // 2 :]]
            taken.append(whole[0])
            ratios.append(np.divide(whole, np.sum([*before, *after], axis=0)))
        times.append((count, median(taken)))
        of_wall, of_cpu = np.median(ratios, axis=0).tolist()
        wall.append((count, of_wall))
        cpu.append((count, of_cpu))
    return {"times": times, "wall": wall, "cpu": cpu, "peak_MiB": peak_MiB()}


def peak_MiB() -> float:
    """Peak resident memory of this process, MiB."""
    # Not `getrusage`: what it counts survives the exec, so that the parent's memory is in it.
    lines = Path("/proc/self/status").read_text().splitlines()
    (peak,) = (line.split()[1] for line in lines if line.startswith("VmHWM"))
    return int(peak) / 1024


def workers(count: int, repeats: int) -> dict[str, Any]:
    """One thread against two; XLA itself may use other cores in either case."""
    twin, experiment, draws = PUBLISHED.twin, PUBLISHED.experiment, PUBLISHED.draws(count)
    cpu: dict[int, float] = {}

    def run(threads: int) -> None:
        began = time.process_time()
        jt.reduce_batch(twin, experiment, draws, REDUCTIONS, workers=threads)
        cpu[threads] = time.process_time() - began

    run(1)
    times = rounds({"1": lambda: run(1), "2": lambda: run(2)}, repeats)
    return {
        "draws": count,
        "wall_s": {name: min(taken) for name, taken in times.items()},
        "cpu_s": {str(threads): seconds for threads, seconds in cpu.items()},
        "two_are_faster_by": median_ratio(times["1"], times["2"]),
    }


def _peer(tool: str, counts: list[int], quick: bool) -> tuple[str, list[tuple[int, float]]]:
    """Tool and setting, and pairs (draws, seconds)."""
    from .ways import fastest

    setting, make = fastest(PUBLISHED, tool, quick)
    points = []
    for count in counts:
        run = make(PUBLISHED, count)
        points.append((count, median(rounds({tool: run}, 3)[tool])))
    return f"{tool}, {setting}", points


if __name__ == "__main__":
    run_alone(measure, __doc__)
