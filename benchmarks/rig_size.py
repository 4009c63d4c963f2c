"""How time and memory of a run grow with the rig: plate elements, and cells.

python -m benchmarks.rig_size --quick

Copper plates of 24 cm x 24 cm with losses that grow with the rise, 1000 s at 1 Hz. Each size has a
process of its own, without kept programs. Times are of processors, over all threads, since other
work on the machine changes them less than the clock. Prints a page, and writes it with a plot to
benchmarks/results.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt

from ._grid_rig import grid_rig
from ._machine import machine
from ._measure import in_fresh_process
from ._tables import table
from .scaling import peak_MiB

BY_NODES = ((8, 2), (16, 2), (24, 2), (30, 2), (42, 2), (60, 2))
BY_CELLS = ((17, 10), (17, 30), (17, 100), (17, 300))
QUICK = ((8, 2), (16, 2))
RESULTS = Path(__file__).parent / "results"


def measure(quick: bool = False) -> dict[str, Any]:
    """**Returns:** `machine`, and `by_nodes` and `by_cells`: what `one_size` gives."""
    environment = {"JAXTWIN_COMPILATION_CACHE": "off"}

    def sizes(cases: tuple[tuple[int, int], ...]) -> list[dict[str, float]]:
        return [in_fresh_process("rig_size:one_size", *c, environment=environment) for c in cases]

    by_nodes = sizes(QUICK if quick else BY_NODES)
    by_cells = sizes(() if quick else BY_CELLS)
    return {"machine": machine(), "by_nodes": by_nodes, "by_cells": by_cells}


def one_size(side: int, cells: int) -> dict[str, float]:
    """CPU seconds and memory of a run.

    **Returns:** `nodes` and `cells`; `netlist_s`: from the rig to its equations; `first_s`: of the
    first run, with that and compilation; `warm_s`: of the best of three more; `peak_MiB`.
    """
    twin = jt.Twin(grid_rig(side, cells))
    began = time.process_time()
    nodes = len(twin.netlist.nodes)
    netlist = time.process_time() - began
    seconds = np.arange(1001.0)
    level = np.where(seconds < 500, 128 / 255, 200 / 255)
    shares = np.random.default_rng(0).uniform(0.2, 1.0, cells)
    experiment = jt.Experiment(seconds, level[:, None] * shares)
    taken = []
    for _ in range(4):
        start = time.process_time()
        twin.simulate(experiment)
        taken.append(time.process_time() - start)
    return {
        "nodes": nodes,
        "cells": cells,
        "netlist_s": netlist,
        "first_s": netlist + taken[0],
        "warm_s": min(taken[1:]),
        "peak_MiB": peak_MiB(),
    }


def page(answer: dict[str, Any]) -> str:
    """What was measured, as Markdown."""
    where = answer["machine"]
    head = ("nodes", "cells", "netlist, s", "first run, s", "warm run, s", "peak memory, MiB")
    parts = []
    parts.append(
        f"# Time and memory against the size of the rig\n\nMeasured {where['date']} by `python -m "
        f"benchmarks.rig_size`: one run of 1000 s at 1 Hz. CPU seconds over all threads; "
        f"{where['processor']}, cores used: {where['cores']}, load {where['load_before']}. The "
        "first run holds the netlist and compilation, without kept programs.\n"
    )
    for title, rows in (("Plate elements", "by_nodes"), ("Cells", "by_cells")):
        cells = [
            (
                row["nodes"],
                row["cells"],
                f"{row['netlist_s']:.2f}",
                f"{row['first_s']:.1f}",
                f"{row['warm_s']:.3f}",
                f"{row['peak_MiB']:.0f}",
            )
            for row in answer[rows]
        ]
        if cells:
            parts.append(f"## {title}\n\n{table(head, cells)}")
    return "\n".join(parts)


def draw(answer: dict[str, Any], path: Path) -> None:
    """Warm time and memory against nodes, and against cells."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, rows, key in zip(axes, ("by_nodes", "by_cells"), ("nodes", "cells"), strict=True):
        sizes = [row[key] for row in answer[rows]]
        axis.loglog(sizes, [row["warm_s"] for row in answer[rows]], "o-", label="warm run, s")
        axis.loglog(sizes, [row["first_s"] for row in answer[rows]], "s-", label="first run, s")
        memory = [row["peak_MiB"] / 1024 for row in answer[rows]]
        axis.loglog(sizes, memory, "^--", label="peak memory, GiB")
        axis.set_xlabel(key)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path, dpi=150)


def _main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    quick = parser.parse_args().quick
    answer = measure(quick)
    if not quick:
        (RESULTS / "rig_size.md").write_text(page(answer))
        draw(answer, RESULTS / "rig_size.png")
    print(page(answer))


if __name__ == "__main__":
    _main()
