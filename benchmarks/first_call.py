"""How long does somebody wait for the first result?

    python -m benchmarks.first_call --rounds 5
    python -m benchmarks.first_call --only match --rounds 1
    python -m benchmarks.first_call --programs match

Everything runs in processes that start afresh, from Python's own start to its end, in turn without
kept programs and with those that an uncounted process has left. Beside the time on the clock stands
what all threads spent on processors, which other work on the machine changes less. Prints a table
in Markdown; `--programs` prints what one of the rows has XLA compile instead, and how long each
program takes to trace and to compile.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from statistics import median

import jaxtwin as jt
from jaxtwin.data import synthetic_recordings

from ._compiled import print_programs
from ._machine import processor

CACHE = "JAXTWIN_COMPILATION_CACHE"
"""The variable that names the folder of kept programs, or turns it off."""

WAYS = ("without", "kept")

MATCH = """
twin = jt.Twin("paper-2024")
names = [name for name, parameter in twin.rig.parameters.items() if parameter.free]
own = ["T_amb"]
jt.match(twin, recordings, free=[*names, *own], per_recording=own, bounds={"T_amb": (0, 40)})
"""

SENSITIVITY = """
jt.sensitivity(jt.Twin("paper-2024"), recordings, draws=10_000)
"""

SIMULATE = """
jt.simulate(jt.Twin("paper-2024"), jt.Experiment.schedule("0:0.5,500:0.78", duration=1000, cells=2))
"""


@dataclass(frozen=True)
class Row:
    """A line of the table: what is timed, and whether it needs the authors' recordings."""

    name: str
    command: Sequence[str]
    needs_recordings: bool = False


@dataclass(frozen=True)
class Cost:
    """Of one process, s: on the clock, and on processors."""

    wall: float
    processors: float


def rows(recordings: Sequence[Path]) -> dict[str, Row]:
    """What is timed, by the name under which it is asked for."""
    first, *_ = recordings
    command = [sys.executable, "-m", "jaxtwin"]
    schedule = ["--duty", "0:0.5,500:0.78", "--duration", "1000", "--out", "run.nc"]
    dual = 'jt.match(jt.Twin("dual-cell"), recordings)'
    return {
        "import": Row("`import jaxtwin; jt.simulate`", _python("jt.simulate", [])),
        "simulate": Row("`import` + `simulate`, `paper-2024`", _python(SIMULATE, [])),
        "command": Row("`jaxtwin simulate`", [*command, "simulate", "paper-2024", *schedule]),
        "match": Row("`match` of `paper-2024`, 19 unknowns", _python(MATCH, recordings)),
        "dual": Row("`match` of `dual-cell`", _python(dual, recordings), needs_recordings=True),
        "validate": Row(
            "`validate` on a recording",
            _python('jt.validate("fit.toml", recordings)', [first]),
            needs_recordings=True,
        ),
        "sensitivity": Row(
            "`sensitivity`, 10 000 draws x 3 recordings", _python(SENSITIVITY, recordings)
        ),
        "demo": Row("`jaxtwin demo`", [*command, "demo", "--out", "report"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="processes of each kind")
    parser.add_argument("--only", nargs="+", metavar="ROW", help="some rows")
    parser.add_argument("--way", choices=WAYS, help="without kept programs, or with them")
    parser.add_argument("--programs", metavar="ROW", help="what this row compiles")
    options = parser.parse_args()
    recordings, are_real = _recordings()
    table = rows(recordings)
    unknown = sorted({*(options.only or ()), options.programs or "import"} - table.keys())
    if unknown:
        parser.error(f"rows: expected some of {', '.join(table)}, got {', '.join(unknown)}")
    ways = WAYS if options.way is None else (options.way,)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        if not {"validate"}.isdisjoint([*(options.only or table), options.programs]) and are_real:
            _save_fit(recordings, place)
        if options.programs:
            _print_what_is_compiled(table[options.programs], place)
            return
        kind = "the authors'" if are_real else "the synthetic"
        cores = len(os.sched_getaffinity(0))
        print(f"{processor()}, cores used: {cores}, jax {version('jax')}, {kind} recordings.\n")
        print("| s on the clock (on processors), medians |", " | ".join(ways), "| load |")
        print("|---|" + "---|" * (len(ways) + 1))
        for name in options.only or table:
            row = table[name]
            if row.needs_recordings and not are_real:
                print(f"| {row.name} | no recordings: set JAXTWIN_RECORDINGS, or fetch them |")
                continue
            before = os.getloadavg()[0]
            costs = [_cost(row, way, place, options.rounds) for way in ways]
            cells = [f"{cost.wall:.2f} ({cost.processors:.2f})" for cost in costs]
            load = f"{before:.1f} to {os.getloadavg()[0]:.1f}"
            print(f"| {row.name} |", " | ".join(cells), f"| {load} |", flush=True)


def _recordings() -> tuple[Sequence[Path], bool]:
    try:
        return jt.find_recordings(), True
    except jt.JaxtwinError:
        return synthetic_recordings(), False


def _python(code: str, recordings: Sequence[Path]) -> list[str]:
    files = [str(file) for file in recordings]
    read = f"recordings = [jt.read_recording(file) for file in {files}]\n" if files else ""
    return [sys.executable, "-c", f"import jaxtwin as jt\n{read}{code}"]


def _save_fit(recordings: Sequence[Path], place: Path) -> None:
    """A fit of `dual-cell` to all recordings but the first, for `validate`."""
    code = 'jt.match(jt.Twin("dual-cell"), recordings).save("fit.toml")'
    subprocess.run(_python(code, recordings[1:]), cwd=place, check=True)


def _cost(row: Row, way: str, place: Path, rounds: int) -> Cost:
    with tempfile.TemporaryDirectory() as kept:
        settings = {CACHE: kept if way == "kept" else "off"}
        if way == "kept":
            _run(row.command, settings, place)
        costs = [_run(row.command, settings, place) for _ in range(rounds)]
    return Cost(median(c.wall for c in costs), median(c.processors for c in costs))


def _run(command: Sequence[str], settings: Mapping[str, str], place: Path) -> Cost:
    environment = os.environ | settings
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    # An installation has the bytecode of its modules.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    began = time.perf_counter()
    process = subprocess.Popen(
        command, cwd=place, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(said.decode())
    return Cost(time.perf_counter() - began, used.ru_utime + used.ru_stime)


def _print_what_is_compiled(row: Row, place: Path) -> None:
    os.environ[CACHE] = "off"
    os.chdir(place)
    print_programs(row.command)


if __name__ == "__main__":
    main()
