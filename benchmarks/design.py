"""Which recording of the paper's rig should be made next?

`dual-cell` is matched to the authors' three step recordings, which leave more of its parameters
open than of those of `paper-2024`. Schedules with the smallest errors of all parameters are
compared with the steps of the recordings and with a pseudo-random binary sequence of the same
duration: D- and A-optimal ones as long as a recording, within its duty cycles and with cooling.

    python -m benchmarks.design

`--fit` takes a saved fit in place of the match. `--only` designs some of the cases and keeps the
earlier results of the others.
"""

import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

LEVELS = 3
CASES: dict[str, dict[str, Any]] = {
    "heating": {"duration": 1000, "hold": 100},
    "cooling": {"duration": 1000, "hold": 100, "cooling": True},
}
TITLES = {
    "heating": "1000 s, heating only",
    "cooling": "1000 s, heating and cooling",
}
STEPS = "the recordings' steps"


def measure(fit_file: Path | None, cases: Sequence[str]) -> dict[str, Any]:
    """**Returns:** what is open today, and case -> criterion -> design."""
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    if fit_file is None:
        fit = jt.match(jt.Twin("dual-cell"), experiments)
    else:
        fit = jt.Fit.load(fit_file, rig="dual-cell", experiments=experiments)
    answer: dict[str, Any] = {
        "fit_percent": fit.mean_fit_percent,
        "directions": len(fit.uncertainty.singular_values),
        "open_directions": len(fit.uncertainty.unidentifiable),
        "cases": {},
    }
    for case in cases:
        found = {criterion: designed(fit, criterion, **CASES[case]) for criterion in ("D", "A")}
        answer["cases"][case] = found
        for criterion, row in found.items():
            print(case, criterion, row["mean_error"], row["cpu_s"], flush=True)
    return answer


def designed(
    fit: jt.Fit, criterion: Any, duration: int, hold: int, cooling: bool = False
) -> dict[str, Any]:
    """A design by one criterion, what it is compared with, and the work that it took."""
    highest = max(float(recording.duty.max()) for recording in fit.experiments)
    began, load = time.process_time(), os.getloadavg()[0]
    design = jt.design_experiment(
        fit,
        duration=duration,
        hold=hold,
        bounds=(-highest if cooling else 0.0, highest),
        levels=LEVELS,
        criterion=criterion,
    )
    repeated = [design.references[recording] for recording in fit.recordings]
    # The three recordings have the same duty, so one of them stands for all.
    assert all(np.array_equal(each.counts, repeated[0].counts) for each in repeated)
    compared = {"designed": design.best, STEPS: repeated[0], "PRBS": design.references["PRBS"]}
    return {
        "schedule": design.text,
        "evaluations": design.history[-1].evaluations,
        "cpu_s": round(time.process_time() - began, 1),
        "load": round(load, 1),
        "mean_error": {name: planned.mean_error for name, planned in compared.items()},
        "highest_reading_degC": {n: planned.highest_reading for n, planned in compared.items()},
        "highest_side_degC": {n: planned.highest_side for n, planned in compared.items()},
        "units": dict(zip(design.names, design.units, strict=True)),
        "values": dict(zip(design.names, design.values, strict=True)),
        "standard_errors": {
            "today": dict(design.standard_errors),
            **{name: dict(planned.standard_errors) for name, planned in compared.items()},
        },
    }


def page(answer: dict[str, Any]) -> str:
    """As Markdown."""
    where = answer["machine"]
    text = (
        f"# The next recording of the paper's rig, designed {where['date']}\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine; nice {os.nice(0)}. "
        "`python -m benchmarks.design`. `dual-cell`, matched to the authors' three step recordings "
        f"(fit {answer['fit_percent']:.1f} %), which determine {answer['open_directions']} of "
        f"{answer['directions']} directions less well than the priors. All 15 channels are read in "
        "the new recording, with the noise of the match and the cells as they were mounted. Levels "
        "of duty: off, the highest of the recordings, and half of it; with cooling off, the "
        "highest, and its opposite. "
        "[Experiment design](../../docs/experiment-design.md) says what follows.\n\n"
        "Predicted mean error of all parameters, in % of today's, by both criteria; and the work "
        "of each search:\n\n"
    )
    known = {case: answer["cases"][case] for case in CASES if case in answer["cases"]}
    rows = [
        (
            TITLES[case],
            criterion,
            *(f"{100 * error:.1f}" for error in found["mean_error"].values()),
            f"{found['highest_reading_degC']['designed']:.1f}",
            f"{found['highest_side_degC']['designed']:.1f}",
            found["evaluations"],
            f"{found['cpu_s']:.0f}",
            f"{found['load']:.1f}",
        )
        for case, by in known.items()
        for criterion, found in by.items()
    ]
    head = ("", "criterion", "designed", STEPS, "PRBS", "hottest reading, degC")
    head += ("hottest cell side, degC", "schedules evaluated", "CPU time, s", "load")
    text += table(head, rows)
    for case, by in known.items():
        text += f"\n## {TITLES[case]}\n\n" + table(
            ("criterion", "schedule, s:duty of both cells"),
            [(criterion, f"`{found['schedule']}`") for criterion, found in by.items()],
        )
        text += "\nStandard errors of the parameters:\n\n" + errors(by)
    return text


def errors(by: Mapping[str, dict[str, Any]]) -> str:
    """A row for each parameter: its standard errors today and after each schedule."""
    first, second = by["D"], by["A"]
    columns = [first["standard_errors"][name] for name in ("today", STEPS, "PRBS", "designed")]
    columns.append(second["standard_errors"]["designed"])
    head = ("parameter", "value", "today", STEPS, "PRBS", "D-optimal", "A-optimal", "unit")
    return table(
        head,
        [
            (name, f"{value:.3g}", *(f"{of[name]:.2g}" for of in columns), first["units"][name])
            for name, value in first["values"].items()
        ],
    )


def main() -> None:
    """Designs and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--fit", type=Path, help="a saved fit, in place of a match")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    options = parser.parse_args()
    path = options.out / "design.json"
    known = json.loads(path.read_text())["cases"] if path.exists() else {}
    answer = {"machine": machine()} | measure(options.fit, options.only)
    answer["cases"] = known | answer["cases"]
    write_results(path, answer, page(answer))


if __name__ == "__main__":
    main()
