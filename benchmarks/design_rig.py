"""Where would the cells of `dual-cell` make its plate most even, and what would a third one give?

    python -m benchmarks.design_rig FOLDER

`dual-cell` with its cells as squares where they are (as in `placed_cells`), by its rig file and
matched to the first halves of the authors' steps in FOLDER, at a mean of 40 degC.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table
from .placed_cells import placed

STEPS = ("peltierMIMOStepSecA.mat", "peltierMIMOStepSecB.mat", "peltierMIMOStepSecC.mat")
MEAN, LIMITS = 40.0, (0.0, 1.0)
GAP = 0.005
"""Between two faces, m."""

QUESTIONS: dict[str, dict[str, Any]] = {
    "least range": {},
    "least standard deviation": {"objective": "standard deviation", "starts": 6},
    "a third cell beside the two where they are": {"further_cells": 1, "moving": []},
    "a third cell, all where they are best": {"further_cells": 1},
    "a fourth one too": {"further_cells": 2, "starts": 6},
}


def answers(twin: jt.Twin) -> dict[str, Any]:
    """Question -> what the design is."""
    found = {}
    for name, settings in QUESTIONS.items():
        given = {"clearance": GAP, "limits": LIMITS} | settings
        began, work = time.perf_counter(), time.process_time()
        design = jt.design_rig(twin, MEAN, **given)
        elements = twin.wiring.elements
        found[name] = {
            "before_K": design.before.point.range,
            "after_K": design.after.point.range,
            "deviation_K": float(np.std(np.asarray(design.after.point.nodes)[:elements])),
            "places_cm": {k: [100 * x, 100 * y] for k, (x, y) in design.after.places.items()},
            "duty": np.asarray(design.after.point.duty).tolist(),
            "duty_before": np.asarray(design.before.point.duty).tolist(),
            "mean_before_degC": float(np.asarray(design.before.point.outputs).mean()),
            "optima_K": list(design.optima),
            "wall_s": time.perf_counter() - began,
            "cpu_s": time.process_time() - work,
        }
        print(name, found[name], flush=True)
    return found


def measure(folder: Path, resolution: str) -> dict[str, Any]:
    """**Returns:** twin -> `answers`."""
    twin = placed(resolution)
    steps = [jt.read_recording(folder / name) for name in STEPS]
    fit = jt.match(twin, [one.between(0, one.duration / 2) for one in steps])
    print(fit.mean_fit_percent, flush=True)
    return {
        "fit_percent": fit.mean_fit_percent,
        "resolution": resolution,
        "rig file": answers(twin),
        "matched": answers(fit.mean_twin),
    }


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where = answer["machine"]
    text = (
        f"# Places of the cells, measured {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.design_rig FOLDER`. `dual-cell` "
        f"with placed cells and elements of {answer['resolution']}, by its rig file and matched to "
        f"the first halves of the authors' steps (fit {answer['fit_percent']:.1f} %), at a mean of "
        f"{MEAN:g} degC with a duty from 0 to 1. Faces are at least {1e3 * GAP:g} mm apart. The "
        "range is that of the elements of the plate.\n"
    )
    head = ("question", "range before, K", "range, K", "standard deviation, K")
    head += ("places, cm", "duty", "optima of the searches, K", "CPU time, s")
    for name in ("rig file", "matched"):
        rows = [
            (
                question,
                f"{found['before_K']:.2f}",
                f"{found['after_K']:.2f}",
                f"{found['deviation_K']:.2f}",
                "; ".join(f"{k} {x:.2f}, {y:.2f}" for k, (x, y) in found["places_cm"].items()),
                ", ".join(f"{duty:.2f}" for duty in found["duty"]),
                ", ".join(f"{value:.2f}" for value in found["optima_K"]),
                f"{found['cpu_s']:.0f}",
            )
            for question, found in answer[name].items()
        ]
        before = next(iter(answer[name].values()))
        duty = " and ".join(f"{one:.2f}" for one in before["duty_before"])
        text += f"\n## {name.capitalize()}\n\nThe duty before is {duty}"
        if before["mean_before_degC"] < MEAN - 0.01:
            text += f", which holds a mean of {before['mean_before_degC']:.1f} degC only"
        text += ".\n\n" + table(head, rows)
    return text


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="the authors' recordings")
    parser.add_argument("--resolution", default="1.5 cm", help="of the plate")
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.folder, options.resolution)
    write_results(options.out / "design_rig.json", answer, page(answer))


if __name__ == "__main__":
    main()
