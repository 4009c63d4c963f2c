"""What do a step of MPC and a gradient for tuning cost?

    python -m benchmarks.controllers --quick

On `dual-cell`, in float64, warm, in CPU time of the process. An MPC of 4 states beside those of
delay and lag, with a horizon of 20 and two outputs, in a closed loop: its step alone, without
limits, with one of the rate, and with one of a channel too. The gradient is that of the integral of
the absolute error over 64 draws of the plant: a PI of the mean over 600 s, and a `DecoupledPI` with
four gains over 1200 s; of the latter also with that of the sensitivity peak of each draw's linear
loop, as `tune` needs it for a `sensitivity_limit`.
"""

import os
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxtwin as jt
from jaxtwin.control import MEASURES, MPC, PID, DecoupledPI, design_mpc, scenario, tuning_problem
from jaxtwin.control.controllers._design_vector import ControllerVector
from jaxtwin.control.tuning._loop_slopes import LoopSlopes

from ._measure import run_alone

OUTPUTS = [["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]]
DRAWS = 64


def measure(quick: bool = False) -> dict[str, Any]:
    """Milliseconds a step, seconds a gradient, and the load of the machine."""
    twin = jt.Twin("dual-cell")
    answer: dict[str, Any] = {}
    model = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0}).reduce(4).discretise(1.0)
    limits: dict[str, dict[str, Any]] = {
        "MPC": {},
        "MPC, limit of the rate": {"rate_limit": 0.05},
        "MPC, limits of the rate and of a channel": {
            "rate_limit": 0.05,
            "temperature_limits": {"T11": (0, 55)},
        },
    }
    steps = 50 if quick else 600
    for name, more in limits.items():
        mpc = design_mpc(model, measured=OUTPUTS, horizon=20, limits=(0, 1), **more)
        answer[f"{name}, ms a step"] = 1e3 * _seconds(_steps(mpc, twin, steps)) / steps
    random = np.random.default_rng(0)
    count = 8 if quick else DRAWS
    draws = {"R_E": random.normal(1.97, 0.1, count), "C_sink": random.normal(200.0, 20.0, count)}
    both = {"measured": OUTPUTS, "limits": (0, 1)}
    loops: dict[str, tuple[Any, float]] = {
        "PI over 600 s": (PID(0.1, 0.001, limits=(0, 1)), 600),
        "DecoupledPI over 1200 s": (DecoupledPI(0.05, 5e-4, 0.05, 5e-4, **both), 1200),
    }
    names = {
        "PI over 600 s": ("Kp", "Ki"),
        "DecoupledPI over 1200 s": ("Kp_mean", "Ki_mean", "Kp_difference", "Ki_difference"),
    }
    kept = {"error": MEASURES["integral_absolute_error"][0]}
    for name, (controller, duration) in loops.items():
        conditions = scenario(twin, controller, 40, duration=duration, quantised=False)
        vector = ControllerVector.of("benchmark", controller, names[name])
        slopes = LoopSlopes(twin, draws, vector, conditions, kept, None)
        answer[f"gradient of a {name}, s"] = _seconds(
            lambda s=slopes, v=vector: s([v.line(v.values)], 1)
        )
    name = "DecoupledPI over 1200 s"
    controller, duration = loops[name]
    problem = tuning_problem(
        "benchmark",
        controller,
        twin,
        40,
        duration,
        tuned=names[name],
        objective="integral_absolute_error",
        draws=draws,
        tail_weight=0.5,
        sensitivity_limit=2.0,
        starts=1,
        seed=0,
        workers=None,
        settings={},
    )
    answer[f"gradient of a {name}, with the sensitivity peak, s"] = _seconds(
        lambda: problem._evaluated([problem.vector.values])
    )
    return answer | {"draws": count, "load": os.getloadavg()[0]}


def _steps(mpc: MPC, twin: jt.Twin, count: int) -> Callable[[], object]:
    """All steps of a warm-up to 40 degC, with the readings of its closed loop."""
    run = jt.simulate_closed_loop(twin, mpc, 40, duration=count)
    rows = run.reference, run.loop.measurement  # with the readings of watched channels

    @jax.jit
    def all_steps(start: Any, rows: Any) -> Any:
        def step(state: Any, row: Any) -> Any:
            duty, later = mpc.step(state, *row)
            return later, duty

        return jax.lax.scan(step, start, rows)[1]

    def taken() -> object:
        with jax.enable_x64(True):
            start = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), rows[1][0]))
            return jax.block_until_ready(all_steps(start, rows))

    return taken


def _seconds(work: Callable[[], object], times: int = 5) -> float:
    """The least CPU time of some calls after the first, which compiles."""
    work()
    found = []
    for _ in range(times):
        began = time.process_time()
        work()
        found.append(time.process_time() - began)
    return min(found)


if __name__ == "__main__":
    run_alone(measure, __doc__)
