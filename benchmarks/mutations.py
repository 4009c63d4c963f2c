"""Breaks the code in small ways and counts how often the tests notice (mutation testing).

    python -m benchmarks.mutations --count 60

Each mutation changes one place of `src/`: a sign, a factor, an off-by-one, a comparison, a flag, or
swaps two arguments. Files are drawn at random from every package in turn, so that large
packages do not crowd out small ones. The tests of the package run first, then all others, until one
fails. What survives is printed with its place: either the mutation changes nothing (say why), or a
test is missing.

The work is done in a copy of the checkout; the checkout itself is not touched.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import final

CHECKOUT = Path(__file__).parent.parent
SOURCE = Path("src/jaxtwin")

ARITHMETIC: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
}
COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
}
LAYOUT = ("plots", "report")
"""Packages whose numbers are mostly sizes on a page; numbers are left alone there."""


@final
@dataclass(frozen=True)
class Mutation:
    """One changed expression of one file."""

    file: Path
    line: int
    before: str
    after: str
    start: int
    end: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}  {self.before}  ->  {self.after}"

    def applied(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]


def main() -> None:
    """Prints each mutation with the test that caught it, then the share that was caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packages", nargs="*", help="only these packages")
    parser.add_argument("--list", action="store_true", help="print the mutations, run nothing")
    arguments = parser.parse_args()

    mutations = draw(arguments.count, random.Random(arguments.seed), arguments.packages)
    if arguments.list:
        print(*mutations, sep="\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "jaxtwin"
        left_out = shutil.ignore_patterns(".git", ".venv*", ".jax_cache", "dist", "report")
        shutil.copytree(CHECKOUT, copy, ignore=left_out)
        if failure := first_failure(copy, ["tests"]):
            sys.exit(f"expected tests that pass before anything is changed, got {failure}")
        survived = [mutation for mutation in mutations if not caught(copy, mutation)]
    share = 1 - len(survived) / len(mutations)
    print(f"\n{share:.0%} of {len(mutations)} mutations were caught; not caught:")
    print(*survived or ["none"], sep="\n")


def caught(copy: Path, mutation: Mutation) -> bool:
    """Whether any test fails with the mutation; says so on the screen."""
    file = copy / mutation.file
    source = file.read_bytes()
    start = time.perf_counter()
    file.write_bytes(mutation.applied(source))
    try:
        package = mutation.file.relative_to(SOURCE).parts[0]
        near = [folder for folder in (f"tests/{package}",) if (copy / folder).is_dir()]
        failure = (near and first_failure(copy, near)) or first_failure(copy, ["tests"])
    finally:
        file.write_bytes(source)
    seconds = time.perf_counter() - start
    print(f"{mutation}\n    {failure or 'NOT CAUGHT'}  ({seconds:.0f} s)", flush=True)
    return bool(failure)


def first_failure(copy: Path, tests: list[str]) -> str:
    """The first failing test's name, or what else pytest ended with; empty if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "2", "--dist=loadfile", *tests]
    environment = {"PYTHONPATH": str(copy / "src")}
    run = subprocess.run(
        command,
        cwd=copy,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode == 0:
        return ""
    lines = run.stdout.splitlines()
    names = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return names[0] if names else f"pytest ended with {run.returncode}"


def draw(count: int, dice: random.Random, packages: list[str] | None) -> list[Mutation]:
    """Mutations spread over all packages and their files."""
    rooms: dict[str, list[Path]] = {}
    for file in sorted((CHECKOUT / SOURCE).rglob("*.py")):
        inside = file.relative_to(CHECKOUT / SOURCE)
        room = inside.parts[0] if len(inside.parts) > 1 else "top level"
        if packages is None or room in packages:
            rooms.setdefault(room, []).append(file)
    for files in rooms.values():
        dice.shuffle(files)
    drawn: list[Mutation] = []
    while len(drawn) < count and any(rooms.values()):
        for files in rooms.values():
            choices = candidates(files.pop()) if files else []
            if choices and len(drawn) < count:
                drawn.append(dice.choice(choices))
    return drawn


def candidates(file: Path) -> list[Mutation]:
    """Every mutation that a file allows."""
    source = file.read_bytes()
    inside = file.relative_to(CHECKOUT)
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def mutation(node: ast.expr, after: str) -> Mutation:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        return Mutation(inside, node.lineno, source[start:end].decode(), after, start, end)

    numbers = inside.parts[2] not in LAYOUT
    tree = ast.parse(source)
    return [
        mutation(node, after)
        for node in expressions(tree)
        for after in changes(node, source.decode(), numbers)
    ]


def expressions(tree: ast.AST) -> Iterator[ast.expr]:
    """All expressions that are run: no annotations, no decorators."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.expr) and not isinstance(child, ast.JoinedStr):
                yield child
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield from expressions(child)


def changes(node: ast.expr, source: str, numbers: bool) -> Iterator[str]:
    """What may stand in an expression's place."""

    def text(part: ast.AST) -> str:
        return ast.get_source_segment(source, part) or ""

    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
            if not is_text(left) and not is_text(right):
                yield f"({text(left)}) {ARITHMETIC[type(op)]} ({text(right)})"
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
            yield f"{text(left)} {COMPARISONS[type(op)]} {text(right)}"
        case ast.BoolOp(op=ast.And(), values=[first, second]):
            yield f"({text(first)}) or ({text(second)})"
        case ast.BoolOp(op=ast.Or(), values=[first, second]):
            yield f"({text(first)}) and ({text(second)})"
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield f"({text(operand)})"
        case ast.Constant(value=bool()):
            yield str(not node.value)
        case ast.Constant(value=int() as value) if numbers:
            yield str(value + 1)
        case ast.Constant(value=float() as value) if numbers and value:
            yield f"({value!r} * 2)"
        case ast.Call(args=[first, second, *rest], keywords=[]) if not any(
            isinstance(argument, ast.Starred) for argument in node.args
        ):
            others = "".join(f", {text(argument)}" for argument in rest)
            yield f"{text(node.func)}({text(second)}, {text(first)}{others})"


def is_text(node: ast.expr) -> bool:
    """Whether an operand is a piece of text, to which `-` does not apply."""
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


if __name__ == "__main__":
    main()
