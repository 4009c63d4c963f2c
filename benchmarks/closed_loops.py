"""What do many closed loops cost, and how far are they from `simulate`?

    python -m benchmarks.closed_loops --quick

A PID on `dual-cell` at 1 Hz, an hour each: loops that differ in the controller, in the plant, and
in the plant with its driver's delay. Time is CPU time of the process for a step of a loop, warm;
the error is that of the channels against `simulate` under the duty that the loop commanded.
"""

import os
import time
from typing import Any

import numpy as np

import jaxtwin as jt
from jaxtwin.control import PID

from ._measure import run_alone

REFERENCES = "0:35,600:45,1800:30"


def measure(quick: bool = False) -> dict[str, Any]:
    """Microseconds a step and loop, errors in K, and the load of the machine."""
    twin = jt.Twin("dual-cell")
    pid = PID(Kp=0.1, Ki=0.001, limits=(0, 1))
    count, duration = (32, 300) if quick else (1000, 3600)
    references = "0:35,150:45" if quick else REFERENCES
    random = np.random.default_rng(0)
    gains = {"Kp": random.uniform(0.05, 0.2, count)}
    plant = {
        "R_E": random.normal(1.97, 0.1, count),
        "C_sink": random.normal(200.0, 20.0, count),
    }
    delays = {"t_delay": random.uniform(0.5, 3.5, count)}
    answer: dict[str, Any] = {"loops": count, "steps": duration}
    for name, options in {
        "controllers": {"controller_draws": gains},
        "plants": {"draws": plant},
        "plants and delays": {"draws": plant | delays},
    }.items():
        for precision in ("float32", "float64"):
            settings: Any = options | {"duration": duration, "precision": precision}
            jt.simulate_closed_loops(twin, pid, references, **settings)  # compiles
            wall, cpu = time.perf_counter(), time.process_time()
            jt.simulate_closed_loops(twin, pid, references, **settings)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            answer[f"{name}, {precision}"] = {
                "us_per_step": 1e6 * cpu / count / duration,
                "cpu_s": cpu,
                "wall_s": wall,
            }
    answer["error_K"] = {
        f"delay {delay} s, {precision}": _error(twin, pid, references, duration, delay, precision)
        for delay in (2.0, 1.37)
        for precision in ("float32", "float64")
    }
    return answer | {"load": os.getloadavg()[0]}


def _error(
    twin: jt.Twin, pid: PID, references: str, duration: int, delay: float, precision: Any
) -> float:
    """The largest in any channel, K."""
    found = jt.simulate_closed_loops(
        twin,
        pid,
        references,
        duration=duration,
        draws={"t_delay": [delay]},
        measures={"temperatures": lambda loop: loop.temperatures, "duty": lambda loop: loop.duty},
        precision=precision,
    )
    experiment = jt.Experiment(np.arange(duration + 1.0), found["duty"][0])
    expected = jt.simulate(twin.with_values({"t_delay": delay}), experiment)
    return float(np.abs(found["temperatures"][0] - expected.temperatures).max())


if __name__ == "__main__":
    run_alone(measure, __doc__)
