"""What do inputs cost that change at every sample, and how exact are the answers?

python -m benchmarks.inputs --quick

Rows of a rig take turns in one process, after compilation. Times are CPU times over all threads,
and ratios those to the drive of two levels in a constant room. Errors are largest ones of the
channels, against the default solver with steps an eighth as long that end at every change.
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin._jax_settings import own_settings
from jaxtwin.simulation import ReductionChoice, build_time_grid, run_exponential
from jaxtwin.simulation._time_grid import SETTLING_SECONDS, step_rule

from ._machine import machine
from ._one_lane import one_lane_compiler
from ._results import parser_of, write_results
from ._tables import table
from ._task import DUAL_CELL, PUBLISHED, Task, drives

PLATE = Path(__file__).parent / "rigs" / "aluminium_plate.toml"

BATCHES = {"paper-2024": PUBLISHED, "dual-cell": DUAL_CELL, "single-cell": Task("single-cell")}

HOUR = 3601
"""The samples of a session of `single-cell`."""


def measure(quick: bool = False) -> dict[str, Any]:
    """**Returns:** `machine`; `plate`: of each room the milliseconds of `simulate` and the seconds
    of `match`; `batches`: of each rig and input the microseconds of a draw, for trajectories, final
    temperatures, and these one draw at a time."""
    return {
        "machine": machine(),
        "plate": _plate(quick),
        "batches": [row for rig in BATCHES for row in _batch(rig, quick)],
    }


def _plate(quick: bool) -> list[dict[str, Any]]:
    twin = jt.Twin(jt.load_rig(PLATE))
    random = np.random.default_rng(0)
    levels = [random.choice([-0.4, 0, 0.3, 0.6], (13, 3)), random.choice([0, 0.5, 1], (13, 1))]
    duty = np.concatenate(levels, axis=1).repeat(60, axis=0)
    moments = np.arange(len(duty)) * 5.0
    slow = 22 + 2 * np.sin(2 * np.pi * moments / 5000)
    noisy = slow + random.normal(0, 0.1, len(moments))
    minutes = np.interp(moments // 60 * 60, moments, slow).round(1)
    rooms = {"constant": None, "drifting": slow, "with noise": noisy, "each minute": minutes}
    start, runs, matches = twin.with_values({"h": 15.0}), {}, {}
    for name, room in rooms.items():
        experiment = jt.Experiment(moments, duty, ambient=room)
        run = twin.simulate(experiment)
        noise = random.normal(0, 0.05, run.temperatures.shape)
        recorded = replace(experiment, channels=run.channels, temperatures=run.temperatures + noise)
        runs[name] = partial(twin.simulate, experiment)
        matches[name] = partial(jt.match, start, recorded)
    simulated, matched = _by_turns(runs, 1 if quick else 7), _by_turns(matches, 1 if quick else 3)
    return [
        {
            "room": name,
            "simulate_ms": 1e3 * simulated[name],
            "match_s": matched[name],
            "error_K": _largest(run().temperatures - _finest(twin, run.args[0])),
        }
        for name, run in runs.items()
    ]


def _batch(rig: str, quick: bool) -> list[dict[str, Any]]:
    task = BATCHES[rig]
    twin, samples = task.twin, HOUR if rig == "single-cell" else 1001
    count = 64 if quick else 512
    draws = task.draws(count)
    own = {name: np.array([float(twin.values[name])]) for name in draws}
    rows, turns = [], 1 if quick else 3
    for name, experiment in drives(len(twin.wiring.cold), samples).items():
        ways: dict[str, Callable[[], object]] = {
            "trajectories_us": partial(_solve, twin, experiment, draws, None),
            "final_us": partial(_solve, twin, experiment, draws, ["final"]),
            "one_lane_us": partial(_solve, twin, experiment, draws, ["final"], one_lane=True),
        }
        row = {way: 1e6 * t / count for way, t in _by_turns(ways, turns).items()}
        simulated = partial(twin.simulate, experiment)
        truth = _finest(twin, experiment)
        rows.append(
            {
                "rig": rig,
                "input": name,
                **row,
                "simulate_ms": 1e3 * _by_turns({"": simulated}, turns)[""],
                "error_of_draw_K": _largest(jt.simulate_batch(twin, experiment, own)[0] - truth),
                "error_of_run_K": _largest(simulated().temperatures - truth),
            }
        )
    return rows


def _solve(
    twin: jt.Twin,
    experiment: jt.Experiment,
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    reductions: ReductionChoice | None,
    one_lane: bool = False,
) -> object:
    os.environ["CC"] = one_lane_compiler() if one_lane else "cc"
    if reductions is None:
        return jt.simulate_batch(twin, experiment, draws)
    return jt.reduce_batch(twin, experiment, draws, reductions)


def _finest(twin: jt.Twin, experiment: jt.Experiment) -> Float[np.ndarray, "times channels"]:
    rule = step_rule(1 / 8, settling=0.0 if twin.wiring.lag is None else SETTLING_SECONDS)
    grid = build_time_grid(experiment, rule, twin.wiring.inputs_and_effects)
    with own_settings():
        return np.asarray(run_exponential(twin, grid, None)[1]) - 273.15


def _by_turns(ways: Mapping[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """The least CPU time of each way, s, after a call that does not count."""
    found = dict.fromkeys(ways, np.inf)
    for turn in range(turns + 1):
        for name, way in ways.items():
            began = time.process_time()
            way()
            if turn:
                found[name] = min(found[name], time.process_time() - began)
    return found


def _largest(difference: np.ndarray) -> float:
    return float(np.abs(difference).max())


def page(answer: Mapping[str, Any]) -> str:
    """What was measured, as Markdown."""
    where, plate = answer["machine"], answer["plate"]
    parts = [
        "# Inputs that change at every sample",
        (
            f"Measured {where['date']} by `python -m benchmarks.inputs`: CPU times over all "
            f"threads, the least of several by turns. {where['processor']}, cores used: "
            f"{where['cores']}, load {where['load_before']}. Errors are the largest of a channel, "
            "against steps an eighth as long that end at every change. Ratios are to the first row "
            "of a rig."
        ),
        "## A plate of 20 cm x 10 cm with three cells and a foil heater, 780 samples of 5 s",
        table(
            ("room", "`simulate`, ms", "ratio", "`match`, s", "ratio", "error, K"),
            [
                (
                    row["room"],
                    f"{row['simulate_ms']:.1f}",
                    f"{row['simulate_ms'] / plate[0]['simulate_ms']:.1f}",
                    f"{row['match_s']:.2f}",
                    f"{row['match_s'] / plate[0]['match_s']:.1f}",
                    f"{row['error_K']:.0e}",
                )
                for row in plate
            ],
        ),
    ]
    head = ("input", "trajectories, µs a draw", "final, µs", "ratio", "one draw at a time, µs")
    head += ("error, K", "`simulate`, ms", "error, K")
    for rig in BATCHES:
        rows = [row for row in answer["batches"] if row["rig"] == rig]
        seconds = HOUR - 1 if rig == "single-cell" else 1000
        parts += [
            f"## {BATCHES[rig].name}, {seconds} s at 1 Hz",
            table(
                head,
                [
                    (
                        row["input"],
                        f"{row['trajectories_us']:.0f}",
                        f"{row['final_us']:.0f}",
                        f"{row['final_us'] / rows[0]['final_us']:.1f}",
                        f"{row['one_lane_us']:.0f}",
                        f"{row['error_of_draw_K']:.0e}",
                        f"{row['simulate_ms']:.1f}",
                        f"{row['error_of_run_K']:.0e}",
                    )
                    for row in rows
                ],
            ),
        ]
    return "\n\n".join(parts)


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    options = parser.parse_args()
    answer = measure(options.quick)
    write_results(options.out / "inputs.json", answer, page(answer))
