"""How far from instability are three controllers of two halves of the plate?

    python -m benchmarks.margins FOLDER --draws 1000

A `DecoupledPI`, an `LQI` and an `MPC`, designed on `dual-cell` with the values of
its rig file, and in the same way on `dual-cell` matched to the first halves of the authors' steps
in FOLDER, then on draws of what that match leaves open: sensitivity peaks. With twice the delay of
the driver: the overshoot of a step from the room, and how much the outputs swing at the end.
"""

from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt
from jaxtwin.control import (
    LQI,
    MEASURES,
    MPC,
    AbstractController,
    DecoupledPI,
    decoupling_of,
    loop_margins,
)
from jaxtwin.matching import posterior_draws

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

STEPS = ("peltierMIMOStepSecA.mat", "peltierMIMOStepSecB.mat", "peltierMIMOStepSecC.mat")
LEFT, RIGHT = ["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]


def examples(twin: jt.Twin, mean: float) -> dict[str, AbstractController]:
    """Those of the page."""
    both: dict[str, Any] = {"measured": [LEFT, RIGHT], "limits": (0, 1)}
    channels = list(twin.channels)
    gain = jt.linearize(twin, duty=0.5).dcgain
    rows = [[channels.index(name) for name in group] for group in (LEFT, RIGHT)]
    outputs = [gain[row].mean(axis=0) for row in rows]
    model = jt.linearize(twin, temperatures={"TAM": mean, "TCM": mean}).reduce(4).discretise(1.0)
    return {
        "DecoupledPI": DecoupledPI(
            0.05, 5e-4, 0.05, 5e-4, decoupling=decoupling_of(outputs), **both
        ),
        "LQI": LQI(model, integral_deviation=30.0, duty_deviation=0.5, reading_noise=5.0, **both),
        "MPC": MPC(model, horizon=20, duty_deviation=0.04, reading_noise=0.5, **both),
    }


def measure(folder: Path, count: int) -> dict[str, Any]:
    """**Returns:** twin -> controller -> peaks, and what twice the delay does."""
    recordings = [jt.read_recording(folder / name) for name in STEPS]
    fit = jt.match(jt.Twin("dual-cell"), [one.between(0, one.duration / 2) for one in recordings])
    answer: dict[str, Any] = {"draws": count}
    for name, twin, mean, drawn in (
        ("rig file", jt.Twin("dual-cell"), 40.0, None),
        ("matched", fit.mean_twin, 32.0, posterior_draws(fit, count)),
    ):
        delay = 2 * float(twin.values["t_delay"])
        late = twin.with_values({"t_delay": delay, "T_start": float(twin.values["T_amb"])})
        answer[name] = {}
        for kind, controller in examples(twin, mean).items():
            margins = loop_margins(twin, controller, mean, draws=drawn)
            run = jt.simulate_closed_loop(late, controller, mean, duration=900, noise=False)
            peaks = margins.sensitivity_peaks
            answer[name][kind] = {
                "peak": margins.sensitivity_peak,
                "peaks": np.quantile(peaks, [0.5, 0.95]).tolist() if drawn else None,
                "is_stable": bool(margins.is_stable),
                "late_overshoot_K": float(MEASURES["overshoot"][0](run.loop)),
                "late_swing_K": float(np.ptp(run.output[-200:], axis=0).max()),
            }
            print(name, kind, answer[name][kind], flush=True)
    return answer


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where = answer["machine"]
    rows = [
        (
            f"{kind}, {name}",
            f"{found['peak']:.2f}",
            " / ".join(f"{peak:.2f}" for peak in found["peaks"] or ()),
            f"{found['late_overshoot_K']:.2f}",
            f"{found['late_swing_K']:.2f}",
        )
        for name in ("rig file", "matched")
        for kind, found in answer[name].items()
    ]
    head = (
        "controller, twin",
        "sensitivity peak",
        f"of {answer['draws']} draws, 50 / 95 %",
        "overshoot at twice the delay, K",
        "swing at its end, K",
    )
    return (
        f"# Margins of three controllers, measured {where['date']}\n\n"
        "`python -m benchmarks.margins FOLDER`. Controllers of two halves of `dual-cell`, at 40 "
        "degC with the values of its rig file, and at 32 degC matched to the first halves of the "
        "authors' steps.\n\n" + table(head, rows)
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="the authors' recordings")
    parser.add_argument("--draws", type=int, default=1000, help="of what the match leaves open")
    options = parser.parse_args()
    answer = {"machine": machine()} | measure(options.folder, options.draws)
    write_results(options.out / "margins.json", answer, page(answer))


if __name__ == "__main__":
    main()
