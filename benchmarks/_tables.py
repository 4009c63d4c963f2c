"""The results as Markdown tables."""

from collections.abc import Iterable
from typing import Any

Cells = Iterable[object]


def results_page(results: dict[str, Any]) -> str:
    """Everything that `benchmarks.compare` measured, with machine and date."""
    parts = [_machine(results["machine"], results["quick"])]
    parts += [_ways(task, table) for task, table in results["ways"].items()]
    parts += [_scaling(results["scaling"]), _matching(results["matching"])]
    return "\n".join(parts)


def _machine(where: dict[str, Any], quick: bool) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in where["versions"].items())
    note = "\nA quick run: whether everything runs; its times mean little.\n" if quick else ""
    return (
        f"# Measured {where['date']}\n{note}\n"
        f"{where['processor']}, cores used: {where['cores']}, {where['memory_GiB']} GiB; "
        f"load {where['load_before']} before, {where.get('load_after', '?')} after. "
        f"Python {where['python']}, {versions}. Devices: {', '.join(where['devices'])}.\n"
    )


def _ways(task: str, answer: dict[str, Any]) -> str:
    rows = [
        (
            name,
            f"{row['ms_per_draw']:.3g}",
            "" if row["error_K"] is None else f"{row['error_K']:.1e}",
            f"{row['times_ours']:.2g}" if row["times_ours"] < 100 else f"{row['times_ours']:.0f}",
            f"{row['cpu_ms_per_draw']:.3g}",
        )
        for name, row in answer["ways"].items()
    ]
    head = ("way", "ms a draw", "largest error, K", "times jaxtwin's time", "CPU ms a draw")
    return (
        f"## {task}: 1000 s at 1 Hz, 15 channels\n\n"
        "Medians of four rounds, of times and of ratios within a round; each way runs twice in a "
        "row, and the second time counts. CPU time is the least of three runs, over all threads. "
        "Other tools run with the fastest of their settings whose error is at most 1e-3 K:\n\n"
        + table(head, rows)
        + "".join(_searched(tool, found) for tool, found in answer["searched"].items())
    )


def _searched(tool: str, found: dict[str, dict[str, float]]) -> str:
    rows = [
        (name, f"{row['ms_per_draw']:.3g}", f"{row['error_K']:.1e}") for name, row in found.items()
    ]
    return f"\nSettings of {tool} that were searched:\n\n" + table(
        ("setting", "CPU ms a draw, over cores", "largest error, K"), rows
    )


def _scaling(answer: dict[str, Any]) -> str:
    counts = sorted({count for points in answer["times"].values() for count, _ in points})
    rows = []
    for name, points in answer["times"].items():
        speeds = {count: f"{count / seconds:,.0f}" for count, seconds in points}
        rows.append((name, *(speeds.get(count, "") for count in counts)))
    head = ("draws a second at", *(f"{count:,} draws" for count in counts))
    ratios = ", ".join(f"{ratio:.2f} at {count:,}" for count, ratio in answer["against_thousands"])
    threads = answer["workers"]
    wall, cpu = threads["wall_s"], threads["cpu_s"]
    return (
        "## Number of draws\n\n"
        + table(head, rows)
        + "\nTime a draw over that of the same draws in calls of 1,000, made before and after: "
        f"{ratios}; largest over smallest {answer['flatness']:.2f} "
        f"(CPU time {answer['cpu_flatness']:.2f}). "
        f"Peak resident memory of {answer['peak_draws']:,} draws: {answer['peak_MiB']:.0f} MiB. "
        f"{threads['draws']:,} draws: one worker {wall['1']:.2f} s ({cpu['1']:.2f} s of CPU time), "
        f"two {wall['2']:.2f} s ({cpu['2']:.2f} s), {threads['two_are_faster_by']:.2f} times as "
        "fast.\n"
    )


def _matching(answer: dict[str, Any]) -> str:
    jacobian = answer["jacobian"]
    rows = [
        (
            name,
            f"{row['first_seconds']:.1f}",
            f"{row['seconds']:.2f}",
            f"{row['rmse_K']:.4f}",
            row["residuals"],
            row["jacobians"],
        )
        for name, row in answer["matches"].items()
    ]
    head = (
        "way",
        "first time, s",
        "warm, s",
        "RMSE reached, K",
        "evaluations of residuals",
        "of the Jacobian",
    )
    return (
        f"## Matching: {answer['recordings']}\n\n"
        f"Jacobian of {jacobian['residuals']} residuals in {jacobian['unknowns']} parameters: "
        f"{1e3 * jacobian['seconds']:.0f} ms warm; the residuals alone "
        f"{1e3 * jacobian['residuals_only_seconds']:.1f} ms. "
        f"A match of {answer['unknowns']} unknowns, on the same residuals, which are compiled "
        "beforehand for SciPy and lmfit:\n\n" + table(head, rows)
    )


def table(head: Cells, rows: Iterable[Cells]) -> str:
    head = list(head)
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)
