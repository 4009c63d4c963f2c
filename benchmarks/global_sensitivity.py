"""Global sensitivity of the paper's rig: how long it takes, how it converges, and what it says.

`speed`: first and total Sobol indices, with bootstrap intervals, of the cost of 15 channels and
their mean in all 20 parameters of `paper-2024` around the published values, 1000 s at 1 Hz; N base
samples are N (20 + 2) runs. Beside it the same work by SALib and SciPy: SALib's sampler and
analyser, and LSODA with the analytic Jacobian for as many runs as `--scipy` says, whose time is
scaled to all runs. The costs of the runs that both did are compared.

It also prints how the 95 % intervals, and the distance from the largest N, fall with N.

`claim`: does the paper's "R_pc, R_E and R_Th lead" hold? The free parameters' Pearson correlations
with the mean cost for 50 and 10 000 draws, their rank correlations, and their Sobol indices of the
cost and of its logarithm, whose tail is not heavy, for the authors' three recordings: at the
published values, at the values of a match with jaxtwin (`--parameters fit.toml`, as `jaxtwin match`
writes it), and over the bounds of Table 4.

    python -m benchmarks.global_sensitivity speed --base 4096 --scipy 220
    python -m benchmarks.global_sensitivity claim --parameters fit.toml
"""

import argparse
import os
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import Sobol, Spearman, indices_of

from ._equations import equations, stretches
from ._task import HELD, Task

Result = TypeVar("Result")
TASK = Task("paper-2024", "published")


def timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """What the work gives, and the seconds that it took: of all cores' work, and of a clock."""
    began, cpu = time.perf_counter(), time.process_time()
    found = work()
    return found, time.process_time() - cpu, time.perf_counter() - began


def names() -> list[str]:
    """All that can be drawn."""
    return [name for name in TASK.twin.parameters if name not in HELD]


def analyse(base: int) -> jt.GlobalSensitivity:
    """Sobol's indices of the cost."""
    return jt.sensitivity(
        TASK.twin, TASK.experiment, method="sobol", draws=base, parameters=names()
    )


def speed(base: int, by_scipy: int) -> None:
    """Prints the times."""
    analyse(8)  # compiles
    found, cpu, wall = timed(lambda: analyse(base))
    runs = len(found.failed)
    print(f"load {os.getloadavg()[0]:.1f}, {len(os.sched_getaffinity(0))} cores")
    print(f"jaxtwin: {runs} runs, {len(found.outputs)} outputs with intervals, {found!r}")
    print(f"  CPU {cpu:.1f} s, clock {wall:.1f} s, {1e3 * cpu / runs:.3f} ms of CPU a run")
    show_convergence(found)
    if not by_scipy:
        return
    from SALib.analyze import sobol as analyser
    from SALib.sample import sobol as sampler

    samples, sampling, _ = timed(
        lambda: sampler.sample(found.problem, base, calc_second_order=False, seed=0)
    )
    some = samples[:by_scipy]
    costs, solving, _ = timed(lambda: lsoda_costs(some))
    difference = np.abs(costs - found.values[: len(some), :-1]).max()
    _, analysing, _ = timed(
        lambda: [
            analyser.analyze(found.problem, column, calc_second_order=False, seed=1)
            for column in found.values.T
        ]
    )
    whole = solving / len(some) * runs
    print(
        f"SALib and SciPy: CPU {sampling + whole + analysing:.0f} s ({sampling:.1f} s samples, "
        f"{whole:.0f} s LSODA, scaled from {len(some)} runs in {solving:.1f} s, {analysing:.1f} s "
        f"indices); costs differ by {difference:.1e} K^2 at most"
    )


def lsoda_costs(samples: Float[np.ndarray, "runs parameters"]) -> Float[np.ndarray, "runs c"]:
    """The mean squared error of each channel, by SciPy."""
    from scipy.integrate import odeint

    recorded = TASK.experiment.temperatures
    assert recorded is not None
    costs = []
    for row in samples:
        network = equations(TASK.twin.with_parameters(dict(zip(names(), row, strict=True))))
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


def show_convergence(found: jt.GlobalSensitivity) -> None:
    """Prints a line for each number of base samples: the first ones of the analysis, as Sobol's
    sequence begins alike."""
    row, blocks = found.row(), found.design.blocks
    print("    N     runs   widest interval: ST, S1   largest distance from the last: ST, S1")
    for base in [1 << power for power in range(6, blocks.bit_length())]:
        part = found.design.of_blocks(np.arange(blocks) < base)
        runs = len(part.unit)
        indices, _ = indices_of(found.method, part, found.values[:runs, [row]])
        widths = [indices[f"{name}_conf"].max() for name in ("ST", "S1")]
        apart = [np.abs(indices[name][0] - found[name][row]).max() for name in ("ST", "S1")]
        print(
            f"{base:5d} {runs:8d}   +-{widths[0]:.3f}, +-{widths[1]:.3f}"
            f"{apart[0]:22.3f}, {apart[1]:.3f}"
        )


def claim(base: int, parameters: str | None) -> None:
    """Prints a table for each centre."""
    rig = jt.load_rig("paper-2024")
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    published = jt.Twin(rig, rig.parameter_sets["published"])
    centres: list[tuple[str, jt.Twin, dict[str, str]]] = [
        ("published values, +-25 %", published, {"inputs": "normal"}),
    ]
    if parameters:
        centres.append(("matched values, +-25 %", jt.Twin(rig, parameters), {"inputs": "normal"}))
    centres.append(("uniform in the bounds of Table 4", published, {"inputs": "bounds"}))
    for words, twin, options in centres:
        few, many, variance = (
            jt.sensitivity(twin, experiments, method=method, draws=draws, **options)  # pyright: ignore[reportArgumentType, reportCallIssue]
            for method, draws in (("pearson", 50), ("pearson", 10_000), ("sobol", base))
        )
        row = variance.row()
        ranks, _ = indices_of(Spearman(), many.design, many.values[:, [row]])
        logarithm, _ = indices_of(Sobol(), variance.design, np.log(variance.values[:, [row]]))
        columns = {
            "Pearson, 50": few["pearson"][row],
            "Pearson, 10 000": many["pearson"][row],
            "Spearman, 10 000": ranks["spearman"][0],
            f"S1, {base}": variance["S1"][row],
            f"ST, {base}": variance["ST"][row],
            "S1 of log cost": logarithm["S1"][0],
            "ST of log cost": logarithm["ST"][0],
        }
        widest = [
            (few["pearson_high"] - few["pearson_low"])[row].max() / 2,
            (many["pearson_high"] - many["pearson_low"])[row].max() / 2,
            (ranks["spearman_high"] - ranks["spearman_low"])[0].max() / 2,
            *(variance[f"{name}_conf"][row].max() for name in ("S1", "ST")),
            *(logarithm[f"{name}_conf"][0].max() for name in ("S1", "ST")),
        ]
        print(f"\n{words}: {few!r}, {many!r}, {variance!r}")
        print(f"{'':10s}" + "".join(f"{name:>18s}" for name in columns))
        for place in np.argsort(-columns["ST of log cost"]):
            cells = "".join(f"{column[place]:18.3f}" for column in columns.values())
            print(f"{variance.names[place]:10s}{cells}")
        print(f"{'widest +-':10s}" + "".join(f"{width:18.3f}" for width in widest))


def main() -> None:
    """Prints what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("part", choices=("speed", "claim"))
    parser.add_argument("--base", type=int, default=4096)
    parser.add_argument("--scipy", type=int, default=220)
    parser.add_argument("--parameters")
    options = parser.parse_args()
    if options.part == "speed":
        speed(options.base, options.scipy)
    else:
        claim(options.base, options.parameters)


if __name__ == "__main__":
    main()
