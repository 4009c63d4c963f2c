"""Draws a second on an accelerator, beside the same program on the CPU.

    make bench-gpu
    python -m benchmarks.gpu --quick

Both rigs, 1000 s at 1 Hz, costs and final temperatures of 1e4, 1e5 and 1e6 draws in float32 and
float64, on the device that JAX finds. Each rig and precision has a process of its own, one after
the other. The first call is that of a process without kept programs. Each size runs three times,
and the shorter of the last two times counts: draws that need shorter steps make the first one
compile further programs. The error is the largest difference in the final temperatures of 256 draws
to the CPU in float64, over all sizes. Leaves out sizes that would start later than nine minutes
after the beginning. Prints a page, and writes it to benchmarks/results/gpu.md.
"""

import argparse
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ._machine import machine
from ._measure import in_fresh_process
from ._tables import table

RIGS = ("paper-2024", "dual-cell")
PRECISIONS = ("float32", "float64")
COUNTS, QUICK_COUNTS = (10_000, 100_000, 1_000_000), (200, 1000)
COMPARED = 256
"""Draws whose final temperatures are compared with the CPU's."""
BUDGET = 540.0
"""Seconds in which everything is to be done."""
PAGE = Path(__file__).parent / "results" / "gpu.md"


def measure(quick: bool = False) -> dict[str, Any]:
    """**Returns:** `machine`, and `rows`: one for each rig and precision, see `draws_a_second`."""
    began, where = time.perf_counter(), machine()
    counts = QUICK_COUNTS if quick else COUNTS
    with tempfile.TemporaryDirectory() as folder:
        environment = {"JAXTWIN_COMPILATION_CACHE": "off", "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
        for rig in RIGS:
            on_the_cpu = {"JAX_PLATFORMS": "cpu", "JAXTWIN_NATIVE": "off"}
            in_fresh_process("gpu:reference", rig, folder, environment=environment | on_the_cpu)

        rows = []
        for rig, precision in product(RIGS, PRECISIONS):
            left = BUDGET - (time.perf_counter() - began)
            found = in_fresh_process(
                "gpu:draws_a_second", rig, precision, counts, left, folder, environment=environment
            )
            rows.append({"rig": rig, "precision": precision, **found})
    return {"machine": where, "counts": counts, "rows": rows, "quick": quick}


def reference(rig: str, folder: str) -> None:
    """Final temperatures of some draws by JAX on the CPU in float64."""
    import jaxtwin as jt

    task = _task(rig)
    final = jt.reduce_batch(task.twin, task.experiment, task.draws(COMPARED), ["final"]).final
    assert final is not None
    np.save(Path(folder) / f"{rig}.npy", final)


def draws_a_second(
    rig: str, precision: Any, counts: list[int], limit: float, folder: str
) -> dict[str, Any]:
    """On the device that JAX finds.

    **Returns:** `first_s`: of the first call, compilation and all; `speed`: pairs (draws, draws a
    second), None for a size that would have begun too late; `peak_MiB`: of the device's memory,
    None where it does not say; `error_K`; `failed`: draws of the largest size; `device`.
    """
    import jax

    import jaxtwin as jt

    began = time.perf_counter()
    task = _task(rig)
    experiment = task.experiment

    def run(count: int) -> tuple[float, jt.simulation.Reductions]:
        draws = task.draws(count)
        start = time.perf_counter()
        result = jt.reduce_batch(
            task.twin, experiment, draws, ["cost", "final"], precision=precision
        )
        return time.perf_counter() - start, result

    expected = np.load(Path(folder) / f"{rig}.npy")
    first, result = run(counts[0])
    error, speed = 0.0, []
    for count in counts:
        if time.perf_counter() - began > limit:
            speed.append((count, None))
            continue
        run(count)
        seconds, result = min((run(count) for _ in range(2)), key=lambda found: found[0])
        speed.append((count, count / seconds))
        assert result.final is not None
        shared = min(count, COMPARED)
        difference = np.abs(result.final[:shared] - expected[:shared])
        error = max(error, float(np.nanmax(difference)))
    statistics = jax.devices()[0].memory_stats() or {}
    peak = statistics.get("peak_bytes_in_use")
    return {
        "first_s": first,
        "speed": speed,
        "peak_MiB": None if peak is None else peak / 2**20,
        "error_K": error,
        "failed": int(result.failed.sum()),
        "device": jax.devices()[0].device_kind,
    }


def page(answer: dict[str, Any]) -> str:
    """What was measured, as Markdown."""
    where = answer["machine"]
    rows = [
        (
            row["rig"],
            row["precision"],
            f"{row['first_s']:.1f}",
            *("" if speed is None else f"{speed:,.0f}" for _, speed in row["speed"]),
            "" if row["peak_MiB"] is None else f"{row['peak_MiB']:,.0f}",
            f"{row['error_K']:.1e}",
            row["failed"],
        )
        for row in answer["rows"]
    ]
    head = (
        "rig",
        "precision",
        "first call, s",
        *(f"draws a second, {count:,} draws" for count in answer["counts"]),
        "peak memory, MiB",
        "largest difference to the CPU, K",
        "failed draws",
    )
    note = (
        "\nA quick run: whether everything runs; its times mean little.\n"
        if answer["quick"]
        else ""
    )
    versions = ", ".join(f"{name} {version}" for name, version in where["versions"].items())
    return (
        f"# Draws a second on {answer['rows'][0]['device']}\n{note}\n"
        f"Measured {where['date']} by `make bench-gpu`: 1000 s at 1 Hz, 15 channels, costs and "
        f"final temperatures. {where['processor']}, cores used: {where['cores']}; Python "
        f"{where['python']}, {versions}. The draws of each "
        "rig and precision are computed by a process of its own, and a size runs three times, of "
        "which the shorter of the last two counts. An empty cell is a size for which nine minutes "
        "were too short, or a device that does not tell its memory.\n\n" + table(head, rows)
    )


def _task(rig: str) -> Any:
    from ._task import DUAL_CELL, PUBLISHED

    return {"paper-2024": PUBLISHED, "dual-cell": DUAL_CELL}[rig]


def _main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    answer = measure(parser.parse_args().quick)
    text = page(answer)
    if not answer["quick"]:
        PAGE.write_text(text)
    print(text)


if __name__ == "__main__":
    _main()
