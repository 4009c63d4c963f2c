"""Breaks the code in small ways and counts how often the tests notice (mutation testing).

    python -m benchmarks.mutations --count 60 --out benchmarks/results

Each mutation changes one place of `src/`: a sign, a factor, an off-by-one, a comparison, a flag, or
swaps two arguments. Files are drawn at random from every package in turn, so that large packages do
not crowd out small ones. Of the tests of `make test`, those of the package run until one fails;
with `--all-tests` all others follow. What survives is printed with its place: either the mutation
changes nothing, or a test is missing.

The outcomes are written to `mutations.json` after each mutation, and the same call goes on where
the last one stopped, so that `--minutes` can cut the work into parts. A survivor that changes
nothing gets its reason there, by hand, under "equivalent". `mutations.md` is the table.

The work is done in a copy of the checkout, which is made once: mutations and tests are those of
the copy, and what changes in the checkout meanwhile has no effect.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import final

CHECKOUT = Path(__file__).parent.parent
SOURCE = Path("src/jaxtwin")
TOP_LEVEL = "top level"
"""Stands for the package of the modules that are in none."""

TESTS = {
    "_compilation": ["tests/compilation/test_*.py"],
    "commands": ["tests/test_cli.py", "tests/test_commands.py", "tests/*/test_command*.py"],
    "doctor": ["tests/test_doctor.py"],
    TOP_LEVEL: ["tests/test_*.py"],
}
"""Package -> its tests, where they are not in `tests/<package>`."""

LONGEST = 900
"""Seconds after which the tests are stopped: a mutation that never ends is one that is noticed."""

LONGEST_TEXT = 200
"""Characters of a mutation in the table."""

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


@final
@dataclass(frozen=True)
class Outcome:
    """What became of a mutation.

    **Arguments:**

    - `mutation`: as text.
    - `package`: in which it is.
    - `failure`: the test that failed, empty if none did.
    - `seconds`: until it failed, or all had passed.
    - `equivalent`: why no test can notice it, written by hand; empty otherwise.
    - `is_own_test`: whether the test was written because nothing else noticed this mutation, set by
      hand.
    """

    mutation: str
    package: str
    failure: str
    seconds: float
    equivalent: str = ""
    is_own_test: bool = False


def main() -> None:
    """Prints each mutation with the test that caught it, then the share that was caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packages", nargs="*", help="only what is drawn of these")
    parser.add_argument("--slow", action="store_true", help="survivors again, with slow tests")
    parser.add_argument("--all-tests", action="store_true", help="not only the package's own")
    parser.add_argument("--tests-pass", action="store_true", help="known: do not try them first")
    parser.add_argument("--workers", type=int, default=2, help="processes that share the tests")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after that time")
    parser.add_argument("--out", type=Path, help="folder for mutations.json and mutations.md")
    parser.add_argument("--list", action="store_true", help="print the mutations, run nothing")
    arguments = parser.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "jaxtwin"
        copy_of_checkout(copy)
        mutations = [
            mutation
            for mutation in draw(copy, arguments.count, random.Random(arguments.seed))
            if not arguments.packages
            or package_of(mutation.file.relative_to(SOURCE)) in arguments.packages
        ]
        if arguments.list:
            print(*mutations, sep="\n")
        else:
            try_each(copy, mutations, arguments)


def try_each(copy: Path, mutations: list[Mutation], arguments: argparse.Namespace) -> None:
    """Tries what no earlier call has tried, and prints each mutation with the test that caught it.

    **Arguments:**

    - `copy`: of the checkout.
    - `arguments`: those of the command line.
    """
    outcomes = read_outcomes(arguments.out)
    left = [mutation for mutation in mutations if str(mutation) not in outcomes]
    if arguments.slow:
        left = [
            mutation
            for mutation in mutations
            if (outcome := outcomes.get(str(mutation)))
            and not outcome.failure
            and not outcome.equivalent
        ]
    end = time.monotonic() + 60 * arguments.minutes
    unbroken: dict[str, str] = {}
    while left and time.monotonic() < end:
        mutation = left.pop(0)
        package = package_of(mutation.file.relative_to(SOURCE))
        tests = tests_of(copy, package, mutation.file.stem)
        if package not in unbroken and not arguments.tests_pass:
            unbroken[package] = first_failure(copy, tests, arguments.workers)
        if failure := unbroken.get(package):
            sys.exit(f"expected tests that pass without a mutation, got {failure}")
        if arguments.all_tests:
            tests = [*tests, "tests"]
        outcome = outcome_of(copy, mutation, tests, arguments.workers, arguments.slow)
        outcomes[outcome.mutation] = outcome
        write_outcomes(arguments.out, outcomes)
        said = outcome.failure or "NOT CAUGHT"
        print(f"{mutation}\n    {said}  ({outcome.seconds:.0f} s)", flush=True)
    print(f"\n{table(list(outcomes.values()))}\n{len(left)} mutations are left to be tried")


def copy_of_checkout(copy: Path) -> None:
    """Without what the Makefile's targets made, but for the compiled programs."""
    left_out = {".git", "dist", "report"} | {file.name for file in CHECKOUT.glob(".venv*")}
    copy.mkdir()
    for part in CHECKOUT.iterdir():
        if part.is_dir() and part.name not in left_out:
            shutil.copytree(part, copy / part.name)
        elif part.name not in left_out:
            shutil.copy2(part, copy)


def outcome_of(
    copy: Path, mutation: Mutation, tests: list[str], workers: int, slow: bool
) -> Outcome:
    """Which test fails with the mutation; `slow`: of those that take long too, where no other
    does."""
    file = copy / mutation.file
    source = file.read_bytes()
    start = time.perf_counter()
    file.write_bytes(mutation.applied(source))
    try:
        failure = first_failure(copy, tests, workers)
        if slow and not failure:
            failure = first_failure(copy, tests, workers, "slow")
    finally:
        file.write_bytes(source)
    package = package_of(mutation.file.relative_to(SOURCE))
    return Outcome(str(mutation), package, failure, round(time.perf_counter() - start, 1))


def first_failure(copy: Path, tests: list[str], workers: int, which: str = "not slow") -> str:
    """The first failing test's name, or what else pytest ended with; empty if all pass.

    **Arguments:**

    - `which`: pytest's expression for the marks of the tests that run.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", which, *tests]
    if workers > 1:
        command += ["-n", str(workers), "--dist=loadfile"]
    environment = {"PYTHONPATH": str(copy / "src")}
    try:
        run = subprocess.run(
            command,
            cwd=copy,
            env=os.environ | environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=LONGEST,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {LONGEST} s"
    if run.returncode in (0, 5):  # 5: no test has these marks
        return ""
    lines = run.stdout.splitlines()
    names = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    if not names:
        return f"pytest ended with {run.returncode}"
    return names[0].partition(" - ")[0].partition(" ")[2]


def package_of(file: Path) -> str:
    """Of a file below `src/jaxtwin`."""
    return file.parts[0] if len(file.parts) > 1 else TOP_LEVEL


def tests_of(copy: Path, package: str, module: str) -> list[str]:
    """The files of a package's own tests, those first that share a word with the module's name."""
    patterns = TESTS.get(package, [f"tests/{package}/test_*.py"])
    files = [str(f.relative_to(copy)) for p in patterns for f in sorted(copy.glob(p))]
    words = set(module.strip("_").split("_")) - {""}
    return sorted(files, key=lambda file: words.isdisjoint(Path(file).stem.split("_")))


def read_outcomes(folder: Path | None) -> dict[str, Outcome]:
    """What earlier calls found, by the mutation's text."""
    file = folder / "mutations.json" if folder else None
    if file is None or not file.exists():
        return {}
    return {row["mutation"]: Outcome(**row) for row in json.loads(file.read_text())}


def write_outcomes(folder: Path | None, outcomes: dict[str, Outcome]) -> None:
    if folder is None:
        return
    rows = [asdict(outcome) for outcome in outcomes.values()]
    (folder / "mutations.json").write_text(json.dumps(rows, indent=1) + "\n")
    (folder / "mutations.md").write_text(table(list(outcomes.values())))


def table(outcomes: list[Outcome]) -> str:
    """How many were caught in each package, then what was not, as Markdown."""
    lines = [
        "# Mutations",
        "",
        "Written by `python -m benchmarks.mutations`. Equivalent mutations change nothing that a",
        "test could notice; the shares are those of all others. A mutation that nothing noticed at",
        "first got a test of its own, which is counted under `caught now`.",
        "",
        "| package | mutations | equivalent | caught at first | share | caught now | share |",
        "|---|---|---|---|---|---|---|",
    ]
    packages = sorted({outcome.package for outcome in outcomes})
    for package in (*packages, "all"):
        rows = [row for row in outcomes if package in (row.package, "all")]
        equivalent = sum(bool(row.equivalent) for row in rows)
        caught = sum(bool(row.failure) for row in rows)
        at_first = sum(bool(row.failure) and not row.is_own_test for row in rows)
        others = len(rows) - equivalent
        first, now = (f"{n / others:.0%}" if others else "" for n in (at_first, caught))
        lines.append(
            f"| {package} | {len(rows)} | {equivalent} | {at_first} | {first} | {caught} | {now} |"
        )
    lines += ["", "| not caught | why |", "|---|---|"]
    for row in outcomes:
        if not row.failure:
            text = textwrap.shorten(row.mutation, LONGEST_TEXT, placeholder=" ...")
            text = text.replace("|", r"\|")
            lines.append(f"| `{text}` | {row.equivalent or 'a test is missing'} |")
    return "\n".join(lines) + "\n"


def draw(copy: Path, count: int, dice: random.Random) -> list[Mutation]:
    """Mutations spread over all packages and their files."""
    rooms: dict[str, list[Path]] = {}
    for file in sorted((copy / SOURCE).rglob("*.py")):
        inside = file.relative_to(copy / SOURCE)
        rooms.setdefault(package_of(inside), []).append(file)
    for files in rooms.values():
        dice.shuffle(files)
    drawn: list[Mutation] = []
    while len(drawn) < count and any(rooms.values()):
        for files in rooms.values():
            choices = candidates(copy, files.pop()) if files else []
            if choices and len(drawn) < count:
                drawn.append(dice.choice(choices))
    return drawn


def candidates(copy: Path, file: Path) -> list[Mutation]:
    """Every mutation that a file allows."""
    source = file.read_bytes()
    inside = file.relative_to(copy)
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
