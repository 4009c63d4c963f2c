"""How exact is the default solver over all bounds of the parameters of the paper's rigs?

    python -m benchmarks.accuracy --draws 1000 --out benchmarks/results

Random draws between the bounds, half of them uniform, half log-uniform (where the lower bound is
above 0), 1000 s at 1 Hz with the recordings' drive, each against Radau at 1e-10 on all cores: a
second or two a draw and core. And the order of convergence, by cutting all steps into ever more
parts.
"""

import json
import time
from itertools import pairwise
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.simulation import TimeGrid, solve_network, time_grid
from jaxtwin.simulation._interpolation import sample_weights, step_polynomials

from ._machine import machine
from ._measure import on_all_cores
from ._pictures import convergence_picture
from ._reference import reference_readings
from ._results import parser_of
from ._task import drive_of_the_recordings

RIGS = ("paper-2024", "dual-cell", "single-cell")
PARTS = (1, 2, 4, 8, 16)
"""Into how many each step of the default grid is cut."""

HELD = ("T_amb_drift",)
"""Not drawn: the reference's equations do not depend on time itself."""

Values = dict[str, float]


def between_bounds(rig: jt.Rig, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Draws of every parameter that has bounds: first uniform ones, then as many log-uniform."""
    rng = np.random.default_rng(seed)
    half = count // 2
    draws = {}
    for name, row in rig.parameters.items():
        if name in HELD or not np.isfinite([row.lower, row.upper]).all():
            continue
        plain = rng.uniform(row.lower, row.upper, count)
        if row.lower > 0:
            plain[half:] = np.exp(rng.uniform(np.log(row.lower), np.log(row.upper), count - half))
        draws[name] = plain
    return draws


def worst_errors(rig: str, count: int) -> dict[str, Any]:
    """Errors of the batch engine's draws, K, and which draw is the worst."""
    twin, drive = jt.Twin(rig), _drive(rig)
    draws = between_bounds(twin.rig, count)
    rows = [{name: float(values[k]) for name, values in draws.items()} for k in range(count)]
    truth = np.stack(on_all_cores(_truth, [(rig, row) for row in rows]))
    answers = {"float64": {}, "float32": {}}
    for precision, entry in answers.items():
        got = jt.simulate_batch(twin, drive, draws, precision=precision)  # pyright: ignore[reportArgumentType]
        errors = np.abs(got - truth).max(axis=(1, 2))
        known = np.isfinite(errors)
        worst = int(np.argmax(np.where(known, errors, -1)))
        entry |= {
            "worst_K": float(errors[worst]),
            "99_percent_K": float(np.percentile(errors[known], 99)),
            "median_K": float(np.median(errors[known])),
            "above_1e-3_K": int((errors[known] > 1e-3).sum()),
            "no_reference": int(np.isnan(truth).any(axis=(1, 2)).sum()),
            "failed": int(np.isnan(got).any(axis=(1, 2)).sum()),
            "worst_draw": rows[worst],
        }
    return {"draws": count, **answers}


def _truth(job: tuple[str, Values]) -> Float[np.ndarray, "times channels"]:
    rig, values = job
    return reference_readings(jt.Twin(rig, values), _drive(rig))


def _drive(rig: str) -> jt.Experiment:
    return drive_of_the_recordings(len(jt.load_rig(rig).cells))


def convergence(rig: str) -> list[tuple[int, float]]:
    """Pairs (steps, worst channel error in K at their ends) of the rig as it comes."""
    twin = jt.Twin(rig)
    whole = time_grid(twin, _drive(rig))
    lengths = np.asarray(whole.sizes)[whole.size]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    duty = np.asarray(whole.duty)
    ends = jt.Experiment(edges, np.concatenate([duty, duty[-1:]]))
    truth = reference_readings(twin, ends, tolerance=1e-12)
    pairs = []
    for parts in PARTS:
        inside = np.concatenate([[0], parts * np.arange(1, len(edges)) - 1]).astype(np.int32)
        changes = 1 + np.flatnonzero(np.any(duty[1:] != duty[:-1], axis=1))
        spans = [np.repeat(span, parts) / parts for span in np.split(lengths, changes)]
        polynomials = step_polynomials(spans)
        at_end = np.minimum(np.arange(len(edges)), 1.0)
        cut = TimeGrid(
            times=edges,
            sizes=np.asarray(whole.sizes) / parts,
            size=np.repeat(whole.size, parts),
            duty=np.repeat(duty, parts, axis=0),
            ambient=None,
            polynomials=polynomials,
            step_of=inside,
            weights=sample_weights(polynomials, inside, at_end),
            ambient_at=None,
        )
        with jax.enable_x64(True):
            got = np.asarray(_solve(twin, cut))
        pairs.append((len(cut.size), float(np.abs(got - truth).max())))
    return pairs


@jax.jit
def _solve(twin: Any, grid: Any) -> Any:
    system = twin.system(lumped=True)
    weights = system.channel_weights
    drive, zones = solve_network(system, grid, system.initial_temperature, weights)
    return system.readings(zones) + drive.reference - 273.15


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=1000, help="of each rig")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    began, answer = time.perf_counter(), {"machine": machine()}
    answer["convergence"] = {rig: convergence(rig) for rig in RIGS}
    (options.out / "convergence.png").write_bytes(convergence_picture(answer["convergence"]))
    answer["errors"] = {}
    for rig in RIGS:
        answer["errors"][rig] = worst_errors(rig, options.draws)
        print(f"{rig}: {time.perf_counter() - began:.0f} s", flush=True)
        (options.out / "accuracy.json").write_text(json.dumps(answer, indent=1) + "\n")
    text = _markdown(answer)
    (options.out / "accuracy.md").write_text(text)
    print(text)


def _markdown(answer: dict[str, Any]) -> str:
    where, lines = answer["machine"], []
    lines += [
        f"Measured {where['date']} on {where['processor']}, against Radau at 1e-10.",
        "",
        "| rig | draws | precision | worst, K | 99 % below, K | median, K | above 1 mK | failed |",
        "|---|---:|---|---:|---:|---:|---:|---:|",
    ]
    for rig, entry in answer["errors"].items():
        for precision in ("float64", "float32"):
            row = entry[precision]
            lines.append(
                f"| {rig} | {entry['draws']} | {precision} | {row['worst_K']:.1e} "
                f"| {row['99_percent_K']:.1e} | {row['median_K']:.1e} | {row['above_1e-3_K']} "
                f"| {row['failed']} |"
            )
    lines += ["", "| rig | error with ever smaller steps, K | orders |", "|---|---|---|"]
    for rig, pairs in answer["convergence"].items():
        errors = ", ".join(f"{error:.1e} ({steps} steps)" for steps, error in pairs)
        orders = [
            np.log(before[1] / after[1]) / np.log(after[0] / before[0])
            for before, after in pairwise(pairs)
        ]
        lines.append(f"| {rig} | {errors} | {', '.join(f'{order:.1f}' for order in orders)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
