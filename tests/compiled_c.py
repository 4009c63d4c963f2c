"""Exported C, compiled for this machine, and what it answers."""

import shutil
import subprocess
from pathlib import Path

import numpy as np

from jaxtwin.c_export import CSources


def compiled(sources: CSources, main: str) -> Path:
    """The program of a `main` beside the sources, without a warning."""
    file = sources.source.with_name("main.c")
    file.write_text(main)
    program = sources.source.with_name("program")
    command = [shutil.which("cc") or "cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    command += ["-Wconversion", "-Wdouble-promotion", "-O2", str(sources.source), str(file)]
    subprocess.run([*command, "-o", str(program), "-lm"], check=True)
    return program


def ran(program: Path, rows: np.ndarray) -> np.ndarray:
    """What it prints for rows of numbers: a row for each."""
    text = "\n".join(" ".join(f"{value!r}" for value in row.tolist()) for row in rows)
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])
