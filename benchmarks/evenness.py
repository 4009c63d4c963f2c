"""How even is the plate of `dual-cell` on its way from the room to 40 degC, and at rest?

    python -m benchmarks.evenness FOLDER

The rig is matched to the first halves of the authors' steps in FOLDER, and starts at the room's
temperature. Controllers side by side on the matched twin, for 1200 s, with the noise of the camera;
the time of a step in Python and in C; and the range that the channels see on a virtual rig.
"""

import json
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxtwin as jt
from jaxtwin.c_export import export_c
from jaxtwin.control import (
    MPC,
    PID,
    ClosedLoopRun,
    LiveLoop,
    RangeCost,
    SquaresCost,
    UniformityMPC,
    WorstPointCost,
    control,
    most_even_point,
)
from jaxtwin.io import Session
from jaxtwin.live import Guard, Recorder, SystemClock, TcpServer, VirtualRig, connect, serve

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

STEPS = ("peltierMIMOStepSecA.mat", "peltierMIMOStepSecB.mat", "peltierMIMOStepSecC.mat")
REFERENCE, DURATION, LIMITS = 40.0, 1200.0, (0.0, 1.0)
LEFT, RIGHT = ["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]
COOLER = (0.0, 0.9)
"""Limits on the virtual rig: at full duty the interlocks stop it, with cell 2 at 125 degC."""

SPEED = 4
"""Of the virtual rig, in times of a real one."""

MAIN = """
#include <stdio.h>
#include <time.h>
#include "model.h"

int main(void)
{
    static model_state state;
    static double duty[MODEL_CELLS], row[MODEL_OUTPUTS + MODEL_READINGS];
    clock_t taken = 0;
    int n = 0, steps = 0;
    while (scanf("%lf", &row[n]) == 1) {
        if (++n < MODEL_OUTPUTS + MODEL_READINGS) {
            continue;
        }
        n = 0;
        if (steps++ == 0) {
            model_init(&state, duty, row + MODEL_OUTPUTS);
        }
        taken -= clock();
        model_step(&state, row, row + MODEL_OUTPUTS, duty);
        taken += clock();
    }
    printf("%.9g", 1e3 * (double)taken / CLOCKS_PER_SEC / steps);
    return 0;
}
"""


def controllers(twin: jt.Twin) -> dict[str, tuple[Any, Any]]:
    """Name -> controller and its references."""
    best = most_even_point(twin, REFERENCE, limits=LIMITS)
    at = dict(zip(twin.channels, np.asarray(best.outputs), strict=True))
    pair = "/".join(f"{np.mean([at[name] for name in half]):.2f}" for half in (LEFT, RIGHT))
    model = jt.linearize(twin, temperatures=REFERENCE)
    halves = MPC(
        model.reduce(4).discretise(1.0),
        measured=[LEFT, RIGHT],
        duty_deviation=0.04,
        reading_noise=0.5,
        limits=LIMITS,
    )
    return {
        "PI of the mean": (PID(0.05, 5e-4, limits=LIMITS), REFERENCE),
        "MPC of two halves, step": (halves, f"0:{pair}"),
        "MPC of two halves, S-curve of 600 s": (halves, f"0:16,curve 600:{pair}"),
        "UniformityMPC": (UniformityMPC(model, limits=LIMITS), REFERENCE),
        "UniformityMPC of the worst point": (
            UniformityMPC(model, limits=LIMITS, evenness=WorstPointCost()),
            REFERENCE,
        ),
        "UniformityMPC of the squares": (
            UniformityMPC(model, limits=LIMITS, evenness=SquaresCost()),
            REFERENCE,
        ),
    }


def simulated(twin: jt.Twin, controller: Any, references: Any, **more: Any) -> ClosedLoopRun:
    """The loop from the temperature of the room on."""
    room = twin.with_values({"T_start": float(twin.values["T_amb"])})
    return jt.simulate_closed_loop(room, controller, references, duration=DURATION, **more)


def row(run: ClosedLoopRun) -> dict[str, float]:
    """What a run took and how even it was."""
    mean = run.run.temperatures.mean(axis=1)
    out = np.flatnonzero(np.abs(mean - REFERENCE) > 0.5)
    rest = run.time >= 0.9 * DURATION
    return {
        "largest_K": float(run.range.max()),
        "rest_K": float(run.range[rest].mean()),
        "seen_K": float(np.ptp(run.run.temperatures, axis=1).max()),
        "mean_degC": float(mean[rest].mean()),
        "settled_s": float(run.time[out[-1]]),
        "energy_kJ": float(run.energy[-1]) / 1e3,
    }


def step_times(twin: jt.Twin) -> dict[str, dict[str, float]]:
    """Milliseconds a step on one core, in Python (warm, in a compiled loop) and in C (cc -O2)."""
    answer = {}
    elements = UniformityMPC(jt.linearize(twin, temperatures=REFERENCE), limits=LIMITS)
    model = jt.linearize(twin, temperatures=REFERENCE)
    settings = {"horizon": 30, "control_horizon": 10, "excess_deviation": 0.1}
    channels = MPC(
        model.reduce(6).discretise(5.0),
        measured=[model.output_names],
        evenness=RangeCost(),
        points=model.output_names,
        limits=LIMITS,
        **settings,
    )
    for name, given in (("24 elements", elements), ("15 channels", channels)):
        mpc = given.for_rig(twin.rig)
        run = simulated(twin, mpc, REFERENCE)
        rows = np.asarray(run.loop.measurement)[np.isclose(run.time % mpc.sample_time_s, 0)]
        with tempfile.TemporaryDirectory() as folder:
            sources = export_c(mpc, folder, rig=twin.rig)
            (sources.source.with_name("main.c")).write_text(MAIN)
            files = [str(sources.source), str(sources.source.with_name("main.c"))]
            program = str(sources.source.with_name("program"))
            subprocess.run(["cc", "-O2", *files, "-o", program, "-lm"], check=True)
            text = "\n".join(" ".join(map(repr, [REFERENCE, *seen])) for seen in rows.tolist())
            in_c = min(
                float(subprocess.run([program], input=text, **_TEXT, check=True).stdout)
                for _ in range(3)
            )
        answer[name] = {"python_ms": _python_ms(mpc, rows), "c_ms": in_c}
    return answer


_TEXT: Any = {"capture_output": True, "text": True}


def _python_ms(mpc: MPC, rows: np.ndarray) -> float:
    @jax.jit
    def all_steps(start: Any, rows: Any) -> Any:
        def step(state: Any, seen: Any) -> Any:
            duty, later = mpc.step(state, jnp.array([REFERENCE]), seen)
            return later, duty

        return jax.lax.scan(step, start, rows)[1]

    with jax.enable_x64(True):
        start = jax.tree.map(jnp.asarray, mpc.init(np.zeros(2), rows[0]))
        taken = []
        for _ in range(5):
            began = time.process_time()
            jax.block_until_ready(all_steps(start, jnp.asarray(rows)))
            taken.append(time.process_time() - began)
    return 1e3 * min(taken) / len(rows)


def on_a_virtual_rig(twin: jt.Twin, duration: float) -> dict[str, float]:
    """The largest differences of the channels' mean and of their range from the simulated ones, and
    the largest range that they saw, K."""
    twin = twin.with_values({"T_start": float(twin.values["T_amb"])})
    mpc = UniformityMPC(jt.linearize(twin, temperatures=REFERENCE), limits=COOLER)
    expected = simulated(twin, mpc, REFERENCE, seed=1).run
    device, server = VirtualRig(twin, speed=SPEED, seed=1), TcpServer("127.0.0.1:0")
    clock, stop = SystemClock(), threading.Event()
    thread = threading.Thread(target=serve, args=(device, server, clock, stop))
    with tempfile.TemporaryDirectory() as folder:
        journal = Path(folder) / "session.db"
        thread.start()
        try:
            with (
                Recorder(journal, twin.rig, clock=clock) as recorder,
                connect(twin.rig, server.url, journal=recorder, clock=clock) as bench,
            ):
                control(bench, Guard.of(twin), LiveLoop(twin, mpc, REFERENCE, duration=duration))
        finally:
            stop.set()
            thread.join()
            server.close()
        with Session(journal) as session:
            decisions = session.database.execute(
                "SELECT arrival, content FROM documents WHERE kind = 'decision'"
            ).fetchall()
            rows = np.array(session.database.execute("SELECT * FROM readings").fetchall(), float)
    arrival, device_us, seen = rows[:, 2], rows[:, 3], rows[:, 6:]
    # The device's time, less that at which the run began; the fastest message had no delay.
    began = np.median([at * 1e-9 * SPEED - json.loads(said)["time"] for at, said in decisions])
    since = device_us * 1e-6 + np.min(arrival * 1e-9 * SPEED - device_us * 1e-6) - began
    seen, since = (
        seen[(since >= 0) & (since <= duration)],
        since[(since >= 0) & (since <= duration)],
    )
    one_by_one = expected.temperatures.T
    wanted = np.array([np.interp(since, expected.time, channel) for channel in one_by_one]).T
    true = simulated(twin, mpc, REFERENCE, seed=1)
    best = most_even_point(twin, REFERENCE, limits=COOLER)
    return {
        "optimum_K": best.range,
        "largest_K": float(true.range.max()),
        "range_off_K": float(np.abs(np.ptp(seen, axis=1) - np.ptp(wanted, axis=1)).max()),
        "mean_off_K": float(np.abs(seen.mean(axis=1) - wanted.mean(axis=1)).max()),
        "seen_K": float(np.ptp(seen, axis=1).max()),
    }


def measure(folder: Path, tcp_s: float) -> dict[str, Any]:
    """**Returns:** what `page` writes."""
    recordings = [jt.read_recording(folder / name) for name in STEPS]
    fit = jt.match(jt.Twin("dual-cell"), [one.between(0, one.duration / 2) for one in recordings])
    twin = fit.mean_twin
    best = most_even_point(twin, REFERENCE, limits=LIMITS)
    answer: dict[str, Any] = {
        "fit_percent": fit.mean_fit_percent,
        "optimum_K": best.range,
        "optimum_seen_K": float(np.ptp(np.asarray(best.outputs))),
        "steps": step_times(twin),
        "controllers": {},
    }
    print(answer, flush=True)
    for name, (controller, references) in controllers(twin).items():
        answer["controllers"][name] = row(simulated(twin, controller, references))
        print(name, answer["controllers"][name], flush=True)
    late = twin.with_values({"t_delay": 2 * float(twin.values["t_delay"])})
    controller, references = controllers(twin)["UniformityMPC"]
    answer["twice_the_delay"] = row(simulated(late, controller, references))
    if tcp_s:
        answer["virtual_rig"] = on_a_virtual_rig(twin, tcp_s) | {"duration_s": tcp_s}
        print(answer["virtual_rig"], flush=True)
    return answer


COLUMNS = {
    "largest_K": ("largest range, K", 2),
    "rest_K": ("range at rest, K", 2),
    "seen_K": ("largest range that the channels see, K", 1),
    "mean_degC": ("mean at rest, degC", 2),
    "settled_s": ("settled, s", 0),
    "energy_kJ": ("energy, kJ", 1),
}


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where = answer["machine"]
    named = {
        **answer["controllers"],
        "UniformityMPC, twice the delay": answer["twice_the_delay"],
    }
    rows = [
        (name, *(f"{found[key]:.{digits}f}" for key, (_, digits) in COLUMNS.items()))
        for name, found in named.items()
    ]
    text = (
        f"# The most even plate on the way, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.evenness FOLDER`. `dual-cell`, "
        f"matched to the first halves of the authors' steps (fit {answer['fit_percent']:.1f} %), "
        f"from the room to a mean of {REFERENCE:g} degC, for {DURATION:.0f} s. The range is that "
        "of the elements of the plate; the least that the two cells can hold is "
        f"**{answer['optimum_K']:.2f} K**, of which the channels see "
        f"{answer['optimum_seen_K']:.1f} K. Settled: the mean of all channels is within 0.5 K.\n\n"
    )
    text += table(("controller", *(head for head, _ in COLUMNS.values())), rows)
    text += "\nA step of a UniformityMPC (horizon 30, control horizon 10), of one core:\n\n"
    times = [
        (name, f"{found['python_ms']:.2f}", f"{found['c_ms']:.2f}")
        for name, found in answer["steps"].items()
    ]
    text += table(("points that are to be even", "Python, ms", "C, ms"), times)
    if "virtual_rig" in answer:
        found = answer["virtual_rig"]
        text += (
            "\nAt full duty the interlocks stop a rig on its way, with cell 2 at 125 degC. "
            f"With a duty of at most {COOLER[1]:g} the least range is "
            f"{found['optimum_K']:.2f} K, the largest on the way {found['largest_K']:.2f} K. "
            f"On a virtual rig over TCP (speed {SPEED}, {found['duration_s']:.0f} s) the range of "
            f"the readings differs from the simulated one by at most {found['range_off_K']:.2f} "
            f"K, and their mean by {found['mean_off_K']:.2f} K, the noise of the camera included.\n"
        )
    return text


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="the authors' recordings")
    parser.add_argument("--tcp", type=float, default=900.0, help="seconds on a virtual rig")
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.folder, options.tcp)
    write_results(options.out / "evenness.json", answer, page(answer))


if __name__ == "__main__":
    main()
