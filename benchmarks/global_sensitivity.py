"""How long does a global sensitivity analysis of the paper's rig take, and how does it converge?

First and total Sobol indices, with bootstrap intervals, of the cost of 15 channels and their mean
in all 20 parameters of `paper-2024` around the published values, 1000 s at 1 Hz; N base samples are
N (20 + 2) runs. Beside it the same work by SALib and SciPy: SALib's sampler and analyser, and LSODA
with the analytic Jacobian for as many runs as `--scipy` says, whose time is scaled to all runs. The
costs of the runs that both did are compared.

    python -m benchmarks.global_sensitivity --base 4096 --scipy 220
"""

import os
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import indices_of

from ._equations import equations, stretches
from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table
from ._task import HELD, Task

Result = TypeVar("Result")
Times = dict[str, float]
TASK = Task("paper-2024", "published")
FEWEST = 64
"""Base samples where the convergence begins."""


def timed(work: Callable[[], Result]) -> tuple[Result, Times]:
    """What the work gives, and the seconds that it took: of CPU, over all cores, and of a clock."""
    began, cpu = time.perf_counter(), time.process_time()
    found = work()
    return found, {"cpu_s": time.process_time() - cpu, "clock_s": time.perf_counter() - began}


def names() -> list[str]:
    """All that can be drawn."""
    return [name for name in TASK.twin.values if name not in HELD]


def analyse(base: int) -> jt.sensitivity_analysis.GlobalSensitivity:
    """Sobol's indices of the cost."""
    return jt.global_sensitivity(
        TASK.twin, TASK.experiment, method="sobol", draws=base, names=names()
    )


def measure(base: int, by_scipy: int) -> dict[str, Any]:
    """Times, differences and convergence."""
    # The first one loads or compiles what the second one has.
    _, first = timed(lambda: analyse(base))
    load = os.getloadavg()[0]
    found, warm = timed(lambda: analyse(base))
    _, estimation = timed(lambda: indices_of(found.method, found.design, found.values))
    return {
        "base": base,
        "parameters": len(found.names),
        "outputs": len(found.outputs),
        "runs": len(found.failed),
        "failed": int(found.failed.sum()),
        "first": first,
        "warm": warm | {"load": load, "nice": os.nice(0)},
        "estimation": estimation,
        "peers": peers(found, base, by_scipy),
        "convergence": convergence(found),
    }


def peers(
    found: jt.sensitivity_analysis.GlobalSensitivity, base: int, by_scipy: int
) -> dict[str, float]:
    """Seconds of CPU by SALib and SciPy, and by how much their costs differ, K^2."""
    from SALib.analyze import sobol as analyser
    from SALib.sample import sobol as sampler

    samples, sampling = timed(
        lambda: sampler.sample(found.problem, base, calc_second_order=False, seed=0)
    )
    some = samples[:by_scipy]
    costs, solving = timed(lambda: lsoda_costs(some))
    _, analysing = timed(
        lambda: [
            analyser.analyze(found.problem, column, calc_second_order=False, seed=1)
            for column in found.values.T
        ]
    )
    return {
        "solved": len(some),
        "sampling_cpu_s": sampling["cpu_s"],
        "solving_cpu_s": solving["cpu_s"] / len(some) * len(samples),
        "analysing_cpu_s": analysing["cpu_s"],
        "costs_differ_by_K2": float(np.abs(costs - found.values[: len(some), :-1]).max()),
    }


def lsoda_costs(samples: Float[np.ndarray, "runs parameters"]) -> Float[np.ndarray, "runs c"]:
    """The mean squared error of each channel, by SciPy."""
    from scipy.integrate import odeint

    recorded = TASK.experiment.temperatures
    assert recorded is not None
    costs = []
    for row in samples:
        network = equations(TASK.twin.with_values(dict(zip(names(), row, strict=True))))
        states = [network.initial[None]]
        for start, end, command in stretches(TASK.experiment, network.delay):
            solution = odeint(
                lambda x, _, network, command: network.rate(x, command),
                states[-1][-1],
                np.arange(start, end + 0.5),
                args=(network, command),
                Dfun=lambda x, _, network, command: network.jacobian(x, command),
                rtol=1e-6,
                atol=1e-6,
                mxstep=10000,
            )
            states.append(solution[1:])
        readings = network.readings(np.concatenate(states))
        costs.append(np.mean((readings - recorded) ** 2, axis=0))
    return np.array(costs)


def convergence(found: jt.sensitivity_analysis.GlobalSensitivity) -> list[dict[str, Any]]:
    """The first base samples of the analysis, as Sobol's sequence begins alike: how wide the
    intervals of the mean cost's indices are, and how far its indices are from those of all."""
    row, blocks, rows = found.row(), found.design.blocks, []
    base = FEWEST
    while base <= blocks:
        part = found.design.of_blocks(np.arange(blocks) < base)
        indices, _ = indices_of(found.method, part, found.values[: len(part.unit), [row]])
        entry: dict[str, Any] = {"base": base, "runs": len(part.unit)}
        for name in ("ST", "S1"):
            entry[f"{name}_widest"] = float(indices[f"{name}_conf"].max())
            entry[f"{name}_apart"] = float(np.abs(indices[name][0] - found[name][row]).max())
        rows.append(entry)
        base *= 2
    return rows


def page(answer: dict[str, Any]) -> str:
    """As Markdown."""
    where, warm, peers = answer["machine"], answer["warm"], answer["peers"]
    total = sum(peers[f"{part}_cpu_s"] for part in ("sampling", "solving", "analysing"))
    runs = f"{answer['runs']:,}"
    text = (
        f"# A global sensitivity analysis, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine; load "
        f"{warm['load']:.1f} when the warm analysis began, {where['load_after']} at the end, nice "
        f"{warm['nice']}. "
        "`python -m benchmarks.global_sensitivity`. Sobol's indices `S1` and `ST` of "
        f"{answer['outputs']} outputs (the cost of each channel and their mean) in "
        f"{answer['parameters']} parameters of `paper-2024` around its published values (normal, "
        f"25 %), with bootstrap intervals: N = {answer['base']} base samples, {runs} runs of "
        f"1000 s at 1 Hz, {answer['failed']} of which failed.\n\n"
    )
    rows = [
        (f"jaxtwin, {words}", f"{times['cpu_s']:.1f}", f"{times['clock_s']:.1f}")
        for words, times in (
            ("first analysis of a process", answer["first"]),
            ("warm", warm),
            ("of these the indices and intervals", answer["estimation"]),
        )
    ]
    rows.append(("SALib and SciPy", f"{total:.0f}", ""))
    text += table(("", "CPU time, s", "clock, s"), rows)
    text += (
        f"\nWarm, a run takes {1e3 * warm['cpu_s'] / answer['runs']:.3f} ms of CPU time. SALib and "
        f"SciPy work on one core: {peers['sampling_cpu_s']:.1f} s for samples, "
        f"{peers['solving_cpu_s']:.0f} s for LSODA with the analytic Jacobian, scaled from "
        f"{peers['solved']} runs, and {peers['analysing_cpu_s']:.1f} s for indices. The costs of "
        f"these runs differ by {peers['costs_differ_by_K2']:.1e} K² at most.\n\n"
        "## Convergence\n\n"
        "Indices of the mean cost from the first N base samples: the widest 95 % interval over the "
        "parameters, and the largest distance from the index of all base samples.\n\n"
    )
    head = ("N", "runs", "widest ST", "widest S1", "ST apart by", "S1 apart by")
    keys = ("ST_widest", "S1_widest", "ST_apart", "S1_apart")
    return text + table(
        head,
        [
            (row["base"], row["runs"], *(f"{row[key]:.3f}" for key in keys))
            for row in answer["convergence"]
        ],
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--base", type=int, default=4096, help="base samples")
    parser.add_argument("--scipy", type=int, default=220, help="runs by SciPy")
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.base, options.scipy)
    answer["machine"]["load_after"] = round(os.getloadavg()[0], 2)
    write_results(options.out / "global_sensitivity.json", answer, page(answer))


if __name__ == "__main__":
    main()
