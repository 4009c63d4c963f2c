"""What a piece of work has XLA compile: each program, its size and its times."""

import re
import runpy
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.monitoring

TRACE = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
)
COMPILE = "/jax/core/compile/backend_compile_duration"


def print_programs(command: Sequence[str]) -> None:
    """Runs `python -c CODE` or `python -m MODULE ARGUMENT...` in this process, and prints a table
    of what was compiled meanwhile, what took longest first."""
    seconds: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    times: dict[str, int] = defaultdict(int)

    def listen(event: str, duration_secs: float, **about: Any) -> None:
        name = re.sub(r"^jit\((.*)\)$|^jit_", r"\1", str(about.get("fun_name", "")))
        if event in TRACE:
            seconds[name][0] += duration_secs
        elif event == COMPILE:
            seconds[name][1] += duration_secs
            times[name] += 1

    jax.monitoring.register_event_duration_secs_listener(listen)
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_dump_ir_to", folder)
        _, option, what, *arguments = command
        if option == "-c":
            exec(compile(what, "<row>", "exec"), {"__name__": "__main__"})
        else:
            sys.argv = [what, *arguments]
            try:
                runpy.run_module(what, run_name="__main__")
            except SystemExit as end:
                if end.code:
                    raise
        lines: dict[str, int] = defaultdict(int)
        for file in Path(folder).glob("*_compile.mlir"):
            name = re.sub(r"^jax_ir\d+_jit_|_compile\.mlir$", "", file.name)
            lines[name] += len(file.read_text().splitlines())
    print("| program | times | lines of StableHLO | traced and lowered, s | compiled, s |")
    print("|---|---|---|---|---|")
    rows = sorted(times, key=lambda name: -sum(seconds[name]))
    for name in rows:
        traced, compiled = seconds[name]
        print(f"| {name} | {times[name]} | {lines[name]} | {traced:.2f} | {compiled:.2f} |")
    traced, compiled = (sum(seconds[name][k] for name in rows) for k in (0, 1))
    count, total = sum(times.values()), sum(lines.values())
    print(f"| all | {count} | {total} | {traced:.2f} | {compiled:.2f} |")
