"""How long does an FMU take to find its network for other parameters?

    python -m benchmarks.fmu_parameters

The C of an FMU for `dual-cell` and for square plates in more and more elements, with two cells:
the time in which it assembles the network, finds its modes and prepares its steps, once before each
simulation, and the time of a step. Compiled by cc with -O2 for the machine at hand; CPU time, the
fastest of some runs.
"""

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jaxtwin as jt
from jaxtwin.c_export._parameter_tables import settable_parameters
from jaxtwin.c_export._parametric_twin_c import parametric_twin_c

from ._grid_rig import grid_rig
from ._machine import compiler, machine
from ._results import parser_of, write_results
from ._tables import table

SIDES = (4, 8, 12, 20, 28)
STEP = 0.05
"""The step of the plates, s, at which that of the finest is stable."""

MAIN = """
#include <stdio.h>
#include <time.h>
#include "model.h"
#define STEPS 1000

static model_numbers numbers;
static model_state state;

int main(void)
{
    static const double values[] = {%s};
    static double nodes[MODEL_NODES], duty[MODEL_CELLS];
    const clock_t begin = clock();
    const char *problem = model_prepare(&numbers, values);
    const clock_t prepared = clock();
    int i;
    if (problem != NULL) {
        return 1;
    }
    state.numbers = &numbers;
    model_init(&state, nodes, duty);
    for (i = 0; i < STEPS; ++i) {
        model_step(&state, duty, 20.0);
    }
    printf("%%g %%g\\n", (double)(prepared - begin) / CLOCKS_PER_SEC,
           (double)(clock() - prepared) / CLOCKS_PER_SEC / STEPS);
    return 0;
}
"""


def twins() -> Iterator[tuple[jt.Twin, float]]:
    """The twins, with the sizes of their steps, s."""
    yield jt.Twin("dual-cell"), 1.0
    for side in SIDES:
        yield jt.Twin(grid_rig(side, 2)), STEP


def measure(twin: jt.Twin, step: float, rounds: int) -> dict[str, Any]:
    """The nodes of a twin, and the seconds of the preparation and of a step."""
    parameters = settable_parameters(twin)
    code = parametric_twin_c(twin, jt.Stepper(twin, step), "model", "", parameters)
    values = ", ".join(repr(float(twin.values[row.name])) for row in parameters)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (
            ("model.h", code.header),
            ("model_numbers.h", code.numbers),
            ("model.c", code.source),
            ("main.c", MAIN % values),
        ):
            (Path(folder) / name).write_text(text)
        command = ["cc", "-std=c99", "-O2", "model.c", "main.c", "-lm", "-o", "timed"]
        subprocess.run(command, cwd=folder, check=True)
        runs = [
            subprocess.run("./timed", cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
            for _ in range(rounds)
        ]
    preparation, of_step = zip(*(map(float, run.stdout.split()) for run in runs), strict=True)
    return {
        "rig": twin.rig.name,
        "nodes": len(twin.netlist.nodes),
        "preparation_s": min(preparation),
        "step_s": min(of_step),
    }


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where = answer["machine"]
    rows = [
        (
            row["rig"],
            row["nodes"],
            f"{float(format(1e3 * row['preparation_s'], '.2g')):g}",
            f"{float(format(1e6 * row['step_s'], '.2g')):g}",
        )
        for row in answer["rows"]
    ]
    columns = ("rig", "nodes", "network, modes and steps, ms", "a step, µs")
    return (
        f"# Parameters in an FMU, measured {where['date']}\n\n"
        f"{where['processor']}, {answer['compiler']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.fmu_parameters`. CPU time of C with "
        f"`-O2`, the fastest of {answer['rounds']} runs.\n\n" + table(columns, rows)
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each program")
    options = parser.parse_args()
    answer = {
        "machine": machine(),
        "compiler": compiler(),
        "rounds": options.rounds,
        "rows": [measure(twin, step, options.rounds) for twin, step in twins()],
    }
    write_results(options.out / "fmu_parameters.json", answer, page(answer))


if __name__ == "__main__":
    main()
