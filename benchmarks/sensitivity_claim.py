"""Does the paper's "R_pc, R_E and R_Th lead" hold?

The free parameters' Pearson correlations with the mean cost for 50 and 10 000 draws, their rank
correlations, and their Sobol indices of the cost and of its logarithm, whose tail is not heavy, for
the authors' three recordings and `paper-2024`: at the published values, at the values of a match
with jaxtwin, and over the bounds of Table 4.

    python -m benchmarks.sensitivity_claim

`--fit` takes a saved fit in place of the match. `--only` measures some of the three and keeps the
earlier results of the others; `bounds` takes several times as long as these.
"""

import json
import os
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import Sobol, Spearman, indices_of

from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

FEW, MANY = 50, 10_000
CENTRES = {
    "published": "Around the published values (normal, 25 %)",
    "matched": "Around our match (normal, 25 %)",
    "bounds": "Over the bounds of Table 4 (uniform)",
}
COLUMNS = {
    "pearson_few": f"Pearson, {FEW} draws",
    "pearson": f"Pearson, {MANY:,} draws",
    "spearman": f"Spearman, {MANY:,} draws",
    "S1": "S1 of the cost",
    "ST": "ST of the cost",
    "S1_log": "S1 of log cost",
    "ST_log": "ST of log cost",
}


def measure(base: int, fit_file: Path | None, centres: Sequence[str]) -> dict[str, Any]:
    """**Returns:** the match where it was asked for, and the indices around each centre."""
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    rig = jt.load_rig("paper-2024")
    published = jt.Twin(rig, rig.parameter_sets["published"])
    answer: dict[str, Any] = {"centres": {}}
    for centre in centres:
        twin, inputs = published, "bounds" if centre == "bounds" else "normal"
        if centre == "matched":
            if fit_file is None:
                fit = jt.match(jt.Twin(rig), experiments)
            else:
                fit = jt.Fit.load(fit_file, rig=rig, experiments=experiments)
            twin, answer["fit"] = fit, matched(fit)
        answer["centres"][centre] = analyse(twin, experiments, inputs, base)
        print(centre, answer["centres"][centre]["cpu_s"], "s of CPU time", flush=True)
    return answer


def matched(fit: jt.Fit) -> dict[str, Any]:
    """How well a match fits, and its values."""
    return {
        "fit_percent": fit.mean_fit_percent,
        "values": {name: row.value for name, row in fit.parameters.items() if row.free},
        "at_bound": [name for name, row in fit.parameters.items() if row.at_bound],
    }


def analyse(
    twin: jt.Twin | jt.Fit, experiments: Sequence[jt.Experiment], inputs: Any, base: int
) -> dict[str, Any]:
    """The indices of each parameter, and the half widths of their widest 95 % intervals."""
    began, load = time.process_time(), os.getloadavg()[0]
    few, many = (
        jt.global_sensitivity(twin, experiments, method="pearson", draws=draws, inputs=inputs)
        for draws in (FEW, MANY)
    )
    variance = jt.global_sensitivity(twin, experiments, method="sobol", draws=base, inputs=inputs)
    row = variance.row()
    ranks, _ = indices_of(Spearman(), many.design, many.values[:, [row]])
    logarithm, _ = indices_of(Sobol(), variance.design, np.log(variance.values[:, [row]]))
    columns = {
        "pearson_few": few["pearson"][row],
        "pearson": many["pearson"][row],
        "spearman": ranks["spearman"][0],
        "S1": variance["S1"][row],
        "ST": variance["ST"][row],
        "S1_log": logarithm["S1"][0],
        "ST_log": logarithm["ST"][0],
    }
    widest = {
        "pearson_few": (few["pearson_high"] - few["pearson_low"])[row].max() / 2,
        "pearson": (many["pearson_high"] - many["pearson_low"])[row].max() / 2,
        "spearman": (ranks["spearman_high"] - ranks["spearman_low"])[0].max() / 2,
        "S1": variance["S1_conf"][row].max(),
        "ST": variance["ST_conf"][row].max(),
        "S1_log": logarithm["S1_conf"][0].max(),
        "ST_log": logarithm["ST_conf"][0].max(),
    }
    order = np.argsort(-columns["ST_log"])
    return {
        "date": date.today().isoformat(),
        "base": base,
        "runs": len(variance.failed),
        "failed": int(variance.failed.sum() + few.failed.sum() + many.failed.sum()),
        "cpu_s": round(time.process_time() - began, 1),
        "load": round(load, 1),
        "parameters": {
            variance.names[place]: {key: float(values[place]) for key, values in columns.items()}
            for place in order
        },
        "widest": {key: float(width) for key, width in widest.items()},
    }


def page(answer: dict[str, Any]) -> str:
    """As Markdown."""
    where, fit = answer["machine"], answer.get("fit")
    text = (
        "# Do R_pc, R_E and R_Th lead?\n\n"
        f"{where['processor']}, cores used: {where['cores']}, a shared machine; "
        "`python -m benchmarks.sensitivity_claim`. Indices of the mean cost of all channels of the "
        "authors' three step recordings, simulated by `paper-2024`, in the order of the total "
        "Sobol index of the logarithm of the cost. "
        "[Sensitivity](../../docs/sensitivity.md#do-r_pc-r_e-and-r_th-lead) says what follows.\n"
    )
    for centre, title in CENTRES.items():
        if centre not in answer["centres"]:
            continue
        found = answer["centres"][centre]
        rows = [
            (name, *(f"{values[key]:.3f}" for key in COLUMNS))
            for name, values in found["parameters"].items()
        ]
        rows.append(("widest 95 %", *(f"±{found['widest'][key]:.3f}" for key in COLUMNS)))
        text += f"\n## {title}\n\n"
        if centre == "matched" and fit is not None:
            values = ", ".join(f"{name} {value:.4g}" for name, value in fit["values"].items())
            text += (
                f"The match has a fit of {fit['fit_percent']:.1f} %, with {values}. At a bound: "
                f"{', '.join(fit['at_bound'])}.\n\n"
            )
        text += (
            f"Measured {found['date']}. Sobol's indices from {found['base']} base samples: "
            f"{found['runs']:,} runs of each recording. Of all runs of this table "
            f"{found['failed']} failed. CPU time {found['cpu_s']:.0f} s, load {found['load']:.1f} "
            "when they began.\n\n"
        )
        text += table(("", *COLUMNS.values()), rows)
    return text


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--base", type=int, default=2048, help="base samples")
    parser.add_argument("--fit", type=Path, help="a saved fit of paper-2024")
    parser.add_argument("--only", nargs="+", choices=CENTRES, default=list(CENTRES))
    options = parser.parse_args()
    path = options.out / "sensitivity_claim.json"
    known = json.loads(path.read_text()) if path.exists() else {"centres": {}}
    answer = measure(options.base, options.fit, options.only)
    answer["centres"] = known["centres"] | answer["centres"]
    answer = known | {"machine": machine()} | answer
    write_results(path, answer, page(answer))


if __name__ == "__main__":
    main()
