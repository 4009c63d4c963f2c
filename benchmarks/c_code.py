"""How many bytes and microseconds does the exported C take?

    python -m benchmarks.c_code

What `export_c` writes for `dual-cell`, two cells and 15 channels: linear models, the nonlinear twin
with all its modes and with twelve, its observer, and controllers. Compiled by cc for the machine at
hand. Bytes of code and constants are those of the object file with -Os, by `size`; the state is the
struct of the header; times are means over an hour of steps of a second with -O2, outputs included,
in the fastest of some runs. Models get random steps of the duty, controllers the readings of their
loop, observers both.
"""

import subprocess
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np

import jaxtwin as jt
from jaxtwin.c_export import export_c
from jaxtwin.control import LQI, MPC, PID, DecoupledPI
from jaxtwin.observers import live_observer
from jaxtwin.simulation import reduce_stepper

from ._machine import compiler, machine
from ._results import parser_of, write_results
from ._tables import table

OUTPUTS = [["T11", "T12", "T21", "T22"], ["T15", "T16", "T25", "T26"]]
PRECISIONS: tuple[Literal["double", "float"], ...] = ("double", "float")
STEPS = 3600

OF_MODEL = """
    model_init(&state);
    for (i = 0; i < STEPS; ++i) {
        model_output(&state, rows[i], seen);
        model_step(&state, rows[i]);
        sum += seen[0];
    }
"""
OF_TWIN = """
    for (i = 0; i < MODEL_NODES; ++i) {
        nodes[i] = MODEL_AMBIENT;
    }
    model_init(&state, nodes, duty);
    for (i = 0; i < STEPS; ++i) {
        model_step(&state, rows[i], MODEL_AMBIENT);
        model_output(&state, MODEL_AMBIENT, seen);
        sum += seen[0];
    }
"""
OF_CONTROLLER = """
    model_init(&state, duty, rows[0] + MODEL_OUTPUTS);
    for (i = 0; i < STEPS; ++i) {
        model_step(&state, rows[i], rows[i] + MODEL_OUTPUTS, duty);
        sum += duty[0];
    }
"""
OF_OBSERVER = """
    model_init(&state, rows[0][MODEL_CELLS], duty);
    for (i = 0; i < STEPS; ++i) {
        model_predict(&state, rows[i]);
        model_correct(&state, rows[i] + MODEL_CELLS, MODEL_AMBIENT);
        model_nodes(&state, nodes);
        sum += nodes[0];
    }
"""
MAIN = """
#include <stdio.h>
#include <time.h>
#include "model.h"
#define STEPS %(steps)d
#define COLUMNS %(columns)d

static model_state state;
static %(real)s rows[STEPS][COLUMNS], duty[COLUMNS], seen[64], nodes[64];

int main(void)
{
    struct timespec begin, end;
    double value, sum = 0;
    int i, j;
    for (i = 0; i < STEPS; ++i) {
        for (j = 0; j < COLUMNS && scanf("%%lf", &value) == 1; ++j) {
            rows[i][j] = (%(real)s)value;
        }
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
%(body)s
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
    printf("%%.9f %%zu %%g %%g\\n",
           (end.tv_sec - begin.tv_sec) + 1e-9 * (end.tv_nsec - begin.tv_nsec),
           sizeof state, sum, (double)(duty[0] + seen[0] + nodes[0]));
    return 0;
}
"""


def measure(rounds: int) -> list[dict[str, Any]]:
    """A row for each program and precision: bytes of code and constants, bytes of the state, and
    the microseconds of a step, the fastest of some rounds."""
    twin = jt.Twin("dual-cell")
    rows = []
    for name, exported, body, inputs in programs(twin):
        for precision in PRECISIONS:
            with tempfile.TemporaryDirectory() as folder:
                rig = twin.rig if body is OF_CONTROLLER else None
                export_c(exported, folder, rig=rig, precision=precision)
                main = MAIN % {
                    "steps": len(inputs),
                    "columns": inputs.shape[1],
                    "real": precision,
                    "body": body,
                }
                found = compiled_and_timed(Path(folder), main, inputs, rounds)
            rows.append({"name": name, "precision": precision, **found})
            print(rows[-1], flush=True)
    return rows


def programs(twin: jt.Twin) -> list[tuple[str, Any, str, np.ndarray]]:
    """Name, what is exported, the loop around it in C, and what each step is given."""
    random = np.random.default_rng(0)
    duty = random.uniform(0.0, 1.0, (60, 2)).repeat(60, axis=0)
    warm = jt.linearize(twin, temperatures={"TAM": 40.0, "TCM": 40.0})
    mean = jt.linearize(twin, duty=0.4)
    design = warm.reduce(4).discretise(1.0)
    stepper = jt.Stepper(twin, 1.0)
    example = np.random.default_rng(1).uniform(-0.3, 1.0, (60, 2)).repeat(60, axis=0)
    small = reduce_stepper(stepper, 12, example)
    plan = jt.Experiment(np.arange(float(STEPS)), duty)
    readings = jt.simulate(twin, plan).to_recording(noise=0.1, seed=0).temperatures
    assert readings is not None
    read = np.hstack([duty, readings])
    two: dict[str, Any] = {"measured": OUTPUTS, "limits": (0, 1)}
    more = {"rate_limit": 0.05, "temperature_limits": {"T11": (0, 55)}}
    controllers = {
        "PI of the mean": PID(0.1, 0.001, limits=(0, 1)),
        "PID of each output": PID([0.1, 0.08], [0.001, 0.002], 1.0, 10.0, **two),
        "`DecoupledPI`": DecoupledPI(0.1, 0.001, 0.2, 0.002, **two),
        "`LQI`": LQI(design, **two),
        "`MPC`, horizon 10": MPC(design, horizon=10, **two),
        "`MPC`, horizon 20": MPC(design, horizon=20, **two),
        "the same with limits of the rate and of a channel": MPC(design, horizon=20, **two, **more),
    }
    made: list[tuple[str, Any, str, np.ndarray]] = [
        ("linear, 30 states", mean.discretise(1.0), OF_MODEL, duty),
        ("linear, 6 states", mean.reduce(6).discretise(1.0), OF_MODEL, duty),
        ("nonlinear twin, all 30 modes", stepper, OF_TWIN, duty),
        ("nonlinear twin, 12 modes", small, OF_TWIN, duty),
        ("observer, all 30 modes", live_observer(twin), OF_OBSERVER, read),
        ("observer, 12 modes", live_observer(twin, stepper=small), OF_OBSERVER, read),
    ]
    for name, controller in controllers.items():
        loop = jt.simulate_closed_loop(twin, controller, "0:30,600:35,1800:28", duration=STEPS)
        inputs = np.hstack([loop.reference, loop.measurement])[:STEPS]
        made.append((name, controller, OF_CONTROLLER, inputs))
    return made


def compiled_and_timed(
    folder: Path, main: str, inputs: np.ndarray, rounds: int
) -> dict[str, float | int]:
    """Compiles an exported program with a loop around it, and runs it."""
    (folder / "main.c").write_text(main)

    def run(*words: str, **more: Any) -> str:
        return subprocess.run(
            words, cwd=folder, check=True, stdout=subprocess.PIPE, text=True, **more
        ).stdout

    run("cc", "-std=c99", "-Os", "-c", "model.c", "-o", "small.o")
    # Column 4 of Berkeley's format: text, data and bss together. Constants are part of the text.
    size = int(run("size", "small.o").splitlines()[1].split()[3])
    run("cc", "-std=gnu99", "-O2", "model.c", "main.c", "-lm", "-o", "timed")
    text = "\n".join(repr(float(value)) for value in inputs.ravel())
    answers = [run("./timed", input=text).split() for _ in range(rounds)]
    seconds = min(float(answer[0]) for answer in answers)
    return {
        "code_and_constants": size,
        "state": int(answers[0][1]),
        "us_a_step": 1e6 * seconds / len(inputs),
    }


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where = answer["machine"]
    rows = [
        (
            f"{row['name']}, `{row['precision']}`",
            f"{row['code_and_constants']:,}".replace(",", " "),
            f"{row['state']:,}".replace(",", " "),
            f"{float(format(row['us_a_step'], '.2g')):g}",
        )
        for row in answer["rows"]
    ]
    columns = ("", "code and constants, bytes", "state, bytes", "time of a step, µs")
    return (
        f"# Exported C, measured {where['date']}\n\n"
        f"{where['processor']}, {answer['compiler']}, a shared machine, load "
        f"{where['load_before']} before; `python -m benchmarks.c_code`. `dual-cell`, a sample time "
        "of 1 s. Bytes with `-Os`, by `size`, without the code of `math.h`; CPU time with `-O2` "
        f"and with outputs, the mean over an hour of steps in the fastest of {answer['rounds']} "
        "runs.\n\n" + table(columns, rows)
    )


def main() -> None:
    """Measures and writes."""
    parser = parser_of(__doc__)
    parser.add_argument("--rounds", type=int, default=20, help="runs of each program")
    options = parser.parse_args()
    answer = {
        "machine": machine(),
        "compiler": compiler(),
        "rounds": options.rounds,
        "rows": measure(options.rounds),
    }
    write_results(options.out / "c_code.json", answer, page(answer))


if __name__ == "__main__":
    main()
