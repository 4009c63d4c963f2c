"""How much CPU time does a draw take in C and by the programs of JAX, for which rigs and results?

    python -m benchmarks.draws_in_c --quick

The two take turns in one process, after compilation. The draws are spread by a fifth around the
rig's values; 1000 s at 1 Hz with a step of the duty, which lids, fans and coolant accompany.
"""

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import normal_draws
from jaxtwin.simulation._native_library import VARIABLE

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

TIME = np.arange(1001.0)
INPUTS: dict[str, dict[str, Any]] = {
    "paper-2024": {},
    "dual-cell": {},
    "tclab": {},
    "heated-box": {
        "lid": np.where((TIME > 600) & (TIME < 660), "open", "closed"),
        "fan": np.where(TIME < 300, 1.0, 0.5),
    },
    "battery-pack": {"T_coolant": 20 + 2 * np.sin(TIME / 100)},
}
"""Rig -> its inputs besides the duty. The coolant has another temperature at each sample."""

RESULTS: dict[str, Any] = {
    "trajectories": None,
    "cost": ["cost"],
    "minimum and maximum": ["minimum", "maximum"],
    "energy and peak power": ["energy", "peak_power"],
    "a function of the user": {"mean": lambda trajectory: trajectory.mean(axis=0)},
}


def measure(quick: bool = False) -> dict[str, Any]:
    """**Returns:** `machine`, and `rows`: rig, result and the microseconds of a draw, `c` and
    `jax`."""
    count, turns = (64, 1) if quick else (1024, 5)
    rows = [
        {"rig": rig, "result": result, **_both(rig, wanted, count, turns)}
        for rig in INPUTS
        for result, wanted in RESULTS.items()
    ]
    return {"machine": machine(), "draws": count, "rows": rows}


def _both(rig: str, wanted: Any, count: int, turns: int) -> dict[str, float]:
    experiment, twin = _recorded(rig)
    drawn = {
        name: float(np.asarray(twin.values[name]))
        for name, row in twin.rig.parameters.items()
        if row.free and row.scope != "recording"
    }
    draws = normal_draws(drawn, 0.2, 0, count)

    def run() -> object:
        if wanted is None:
            return jt.simulate_batch(twin, experiment, draws)
        return jt.reduce_batch(twin, experiment, draws, wanted)

    taken: dict[str, list[float]] = {"on": [], "off": []}
    for _ in range(turns):
        for setting, times in taken.items():
            os.environ[VARIABLE] = setting
            if not times:
                run()
            times.append(_cpu_seconds(run))
    c, jax = (1e6 * float(np.median(times)) / count for times in taken.values())
    return {"c": c, "jax": jax}


def _recorded(rig: str) -> tuple[jt.Experiment, jt.Twin]:
    """A step of the duty, with what the twin answers as its recording."""
    twin = jt.Twin(rig)
    level = np.where(TIME < 500, 0.5, 0.8)
    duty: Float[np.ndarray, "times cells"] = np.outer(level, np.ones(len(twin.wiring.cold)))
    run = twin.simulate(jt.Experiment(TIME, duty, inputs=INPUTS[rig]))
    return run.to_recording(), twin


def _cpu_seconds(run: Callable[[], object]) -> float:
    began = time.process_time()
    run()
    return time.process_time() - began


def page(answer: Mapping[str, Any]) -> str:
    """What was measured, as Markdown."""
    where = answer["machine"]
    rows = [
        (
            row["rig"],
            row["result"],
            f"{row['c']:.0f}",
            f"{row['jax']:.0f}",
            f"{row['jax'] / row['c']:.1f}",
        )
        for row in answer["rows"]
    ]
    head = ("rig", "result", "in C, µs", "by JAX, µs", "ratio")
    return (
        f"# Draws in C and by JAX\n\nMeasured {where['date']} by `python -m "
        f"benchmarks.draws_in_c`: CPU time of each of {answer['draws']} draws, over all threads, "
        f"medians of five rounds. {where['processor']}, cores used: {where['cores']}, load "
        f"{where['load_before']}.\n\n"
        f"{table(head, rows)}"
    )


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    options = parser.parse_args()
    answer = measure(options.quick)
    write_results(options.out / "draws_in_c.json", answer, page(answer))


if __name__ == "__main__":
    _main()
