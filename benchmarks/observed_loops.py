"""Does a controller that reads an observer of the twin hold its outputs better?

    python -m benchmarks.observed_loops

`dual-cell` is held at 40 degC for half an hour by an `MPC` and an `LQI` with their defaults, each
with the Kalman filter of its linear model alone, with an observer of the twin, and with one that
reads a measured room. The camera corrects itself, a hand of 10 W lies on the plate, or the room
becomes 8 K warmer, at once or within five minutes; the last scene has sensors that touch the plate
in place of the camera, which sees a part of the room. The table has the root mean square and the
largest of the true errors of both outputs, after the first ten minutes.
"""

import os
from typing import Any

import numpy as np

import jaxtwin as jt
from jaxtwin.control import LQI, MPC, AbstractController, HeatInput
from jaxtwin.observers import live_observer

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

REFERENCE, DURATION, SETTLED = 40.0, 1800.0, 600.0
EVENT, END = 900.0, 1500.0
DRIFT = f"0:16,{EVENT:g}:16,ramp {EVENT + 300:g}:24"
TOUCHING = "the same, sensors touch the plate"
MEASURED = "with an observer and a measured room"
SCENES: dict[str, dict[str, Any]] = {
    "the camera corrects itself every 164 s": {"faults": "jumps=164"},
    "a hand of 10 W on the plate": {
        "disturbances": [HeatInput(elements=("V14", "V15"), start=EVENT, end=END, heat=10.0)]
    },
    "a room that is 8 K warmer at once": {"ambient": f"0:16,{EVENT:g}:24"},
    "the same within 5 minutes": {"ambient": DRIFT},
    TOUCHING: {"ambient": DRIFT},
}


def controllers(twin: jt.Twin) -> dict[str, AbstractController]:
    """Those of the table, designed in one way."""
    linear = jt.linearize(twin, temperatures={"TAM": REFERENCE, "TCM": REFERENCE})
    settings: dict[str, Any] = {"measured": ["TAM", "TCM"], "limits": (0, 1)}
    model, observer = linear.reduce(4).discretise(1.0), live_observer(twin)
    return {
        "MPC": MPC(model, **settings),
        "MPC with an observer": MPC(model, observer=observer, **settings),
        f"MPC {MEASURED}": MPC(model, observer=observer, **settings),
        "LQI": LQI(model, **settings),
        "LQI with an observer": LQI(model, observer=observer, **settings),
        f"LQI {MEASURED}": LQI(model, observer=observer, **settings),
    }


def measure(runs: int) -> dict[str, Any]:
    """Scene -> controller -> root mean square and largest error, K."""
    seen = jt.Twin("dual-cell")
    gains = [name for name in seen.rig.parameters if name.startswith("g_")]
    touched = seen.with_values({name: np.asarray(1.0) for name in gains})
    answer: dict[str, Any] = {scene: {} for scene in SCENES}
    for scene, happening in SCENES.items():
        twin = touched if scene == TOUCHING else seen
        for name, controller in controllers(twin).items():
            errors = []
            for seed in range(runs):
                run = jt.simulate_closed_loop(
                    twin,
                    controller,
                    REFERENCE,
                    duration=DURATION,
                    seed=seed,
                    room_is_measured=name.endswith(MEASURED),
                    **happening,
                )
                errors.append(run.output[np.asarray(run.time) > SETTLED] - REFERENCE)
            answer[scene][name] = {
                "root_mean_square_K": float(np.sqrt(np.mean(np.square(errors)))),
                "largest_K": float(np.abs(errors).max()),
            }
            print(scene, name, answer[scene][name], flush=True)
    return answer


def page(answer: dict[str, Any], runs: int) -> str:
    """The results as Markdown."""
    names = list(next(iter(answer["scenes"].values())))
    rows = [
        (
            scene,
            *(
                f"{found[name]['root_mean_square_K']:.2f} K, {found[name]['largest_K']:.1f} K"
                for name in names
            ),
        )
        for scene, found in answer["scenes"].items()
    ]
    where = answer["machine"]
    return (
        f"# Controllers with an observer, measured {where['date']}\n\n"
        f"`python -m benchmarks.observed_loops`. `dual-cell` held at {REFERENCE:g} degC for "
        f"{DURATION:g} s, {runs} runs each, heat and room from {EVENT:g} s on: root mean square "
        f"of the true error after {SETTLED:g} s, and its largest value.\n\n"
        + table(("", *names), rows)
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=5, help="of each loop, with other noise")
    options = parser.parse_args()
    answer = {"machine": machine(), "load": os.getloadavg()[0], "scenes": measure(options.runs)}
    write_results(options.out / "observed_loops.json", answer, page(answer, options.runs))


if __name__ == "__main__":
    main()
