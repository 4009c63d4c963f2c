"""Breaks the code in small ways and counts how often the tests notice (mutation testing).

    python -m benchmarks.mutations --count 60 --seed 1 --out benchmarks/results
    python -m benchmarks.mutations --count 60 --seed 1 --out benchmarks/results --slow

Each mutation changes one place of `src/`: a sign, a factor, an off-by-one, a comparison, a flag, or
swaps two arguments (`_mutants.py`). Files are drawn at random from every package in turn, so that
large packages do not crowd out small ones, and nothing is drawn that an earlier call has tried.
Tests run until one fails: the nearest of the package and of all others (`_nearest_tests.py`), then
what is left of the package. Of these, the first call runs those of `make test`; `--slow` tries what
they let through with the slow ones. What survives both is printed with its place: the mutation
changes nothing, a test elsewhere notices it, or a test is missing. `--again` tries the survivors
with the tests that were written for them.

The outcomes are written to `mutations.json` after each mutation, and the same call goes on where
the last one stopped, so that `--minutes` can cut the work into parts. A survivor that changes
nothing gets its reason there, by hand, under "equivalent". `mutations.md` is the table.

The work is done in a copy of the checkout, which is made once: mutations and tests are those of
the copy, and what changes in the checkout meanwhile has no effect.
"""

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import final

from ._mutants import SOURCE, TOP_LEVEL, Mutation, draw, package_of
from ._nearest_tests import NearestTests, by_file
from ._warm_pytest import first_failure, import_libraries

CHECKOUT = Path(__file__).parent.parent

TESTS = {
    "_compilation": ["tests/compilation/test_*.py"],
    "commands": ["tests/commands/test_*.py", "tests/*/test_command*.py"],
    "doctor": ["tests/test_doctor.py"],
    TOP_LEVEL: ["tests/test_*.py"],
}
"""Package -> its tests, where they are not in `tests/<package>`."""

UNBROKEN = "tests/rig/test_value.py"
"""Tests that say whether all is well without a mutation."""

LONGEST_TEXT = 200
"""Characters of a mutation in the table."""


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
    - `is_own_test`: whether the test was written because nothing else noticed this mutation.
    - `seed`: with which it was drawn; none was noted at first.
    """

    mutation: str
    package: str
    failure: str
    seconds: float
    equivalent: str = ""
    is_own_test: bool = False
    seed: int | None = None


def main() -> None:
    """Prints each mutation with the test that caught it, then the share that was caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--packages", nargs="*", help="only what is drawn of these")
    parser.add_argument("--slow", action="store_true", help="survivors again, with slow tests")
    parser.add_argument("--again", action="store_true", help="survivors again, with new tests")
    parser.add_argument(
        "--limit", type=float, default=600, help="CPU seconds after which no test of a part begins"
    )
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after that time")
    parser.add_argument("--out", type=Path, help="folder for mutations.json and mutations.md")
    parser.add_argument("--list", action="store_true", help="print the mutations, run nothing")
    arguments = parser.parse_args()
    outcomes = read_outcomes(arguments.out)
    earlier = {text for text, outcome in outcomes.items() if outcome.seed != arguments.seed}

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "jaxtwin"
        copy_of_checkout(copy)
        mutations = [
            mutation
            for mutation in draw(copy, arguments.count, random.Random(arguments.seed), earlier)
            if not arguments.packages
            or package_of(mutation.file.relative_to(SOURCE)) in arguments.packages
        ]
        if arguments.list:
            print(*mutations, sep="\n")
            return
        import_libraries()
        try_each(copy, mutations, outcomes, arguments)


def try_each(
    copy: Path,
    mutations: list[Mutation],
    outcomes: dict[str, Outcome],
    arguments: argparse.Namespace,
) -> None:
    """Tries what no earlier call has tried, and prints each mutation with the test that caught it.

    **Arguments:**

    - `copy`: of the checkout.
    - `outcomes`: of earlier calls; those of this one are added.
    - `arguments`: those of the command line.
    """
    if arguments.slow or arguments.again:
        left = survivors(mutations, outcomes)
    else:
        left = [mutation for mutation in mutations if str(mutation) not in outcomes]
    end = time.monotonic() + 60 * arguments.minutes
    nearest = NearestTests(copy)
    if failure := first_failure(copy, [UNBROKEN], slow=False, limit=arguments.limit):
        sys.exit(f"expected tests that pass without a mutation, got {failure}")
    while left and time.monotonic() < end:
        mutation = left.pop(0)
        package = package_of(mutation.file.relative_to(SOURCE))
        own = tests_of(copy, package)
        tests = list(dict.fromkeys([*nearest.of(mutation, own), *own]))
        start = time.perf_counter()
        failure = first_failure_with(copy, mutation, tests, arguments)
        seconds = round(time.perf_counter() - start, 1)
        known = outcomes.get(str(mutation), Outcome(str(mutation), package, "", 0.0))
        outcome = replace(
            known,
            failure=failure,
            seconds=round(known.seconds + seconds, 1),
            seed=arguments.seed,
            is_own_test=arguments.again and bool(failure),
        )
        outcomes[outcome.mutation] = outcome
        write_outcomes(arguments.out, outcomes)
        print(f"{mutation}\n    {failure or 'NOT CAUGHT'}  ({seconds:.0f} s)", flush=True)
    print(f"\n{table(list(outcomes.values()))}\n{len(left)} mutations are left to be tried")


def survivors(mutations: list[Mutation], outcomes: Mapping[str, Outcome]) -> list[Mutation]:
    """Those that were tried and are neither caught nor equivalent."""
    return [
        mutation
        for mutation in mutations
        if (outcome := outcomes.get(str(mutation)))
        and not outcome.failure
        and not outcome.equivalent
    ]


def copy_of_checkout(copy: Path) -> None:
    """Without what the Makefile's targets made; the compiled programs are links."""
    left_out = {".git", ".jax_cache", "build", "dist", "report"}
    left_out |= {file.name for file in CHECKOUT.glob(".venv*")}
    copy.mkdir()
    for part in CHECKOUT.iterdir():
        if part.is_dir() and part.name not in left_out:
            shutil.copytree(part, copy / part.name)
        elif part.name not in left_out:
            shutil.copy2(part, copy)
    kept = copy / ".jax_cache" / "kept"
    kept.mkdir(parents=True)
    for program in CHECKOUT.glob(".jax_cache/*/*"):
        if not (kept / program.name).exists():
            (kept / program.name).symlink_to(program)


def first_failure_with(
    copy: Path, mutation: Mutation, tests: list[str], arguments: argparse.Namespace
) -> str:
    """The first test that fails with a mutation, empty if none does; the copy is then as it was."""
    file = copy / mutation.file
    source, changed = file.read_bytes(), file.stat().st_mtime_ns
    try:
        file.write_bytes(mutation.applied(source))
        found = (
            first_failure(copy, part, arguments.slow, arguments.limit) for part in parts(tests)
        )
        return next(filter(None, found), "")
    finally:
        file.write_bytes(source)
        os.utime(file, ns=(changed, changed))  # its bytecode is valid again


def parts(tests: list[str]) -> Iterator[list[str]]:
    """The tests of the first file, of the next three, and all others: most mutations are noticed by
    the first, and to collect all tests takes longer than to run those."""
    files = by_file(tests)
    for some in (files[:1], files[1:4], files[4:]):
        if part := [test for file in some for test in file]:
            yield part


def tests_of(copy: Path, package: str) -> list[str]:
    """The files of a package's own tests."""
    patterns = TESTS.get(package, [f"tests/{package}/test_*.py"])
    return [str(f.relative_to(copy)) for p in patterns for f in sorted(copy.glob(p))]


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
    seeds = sorted({outcome.seed for outcome in outcomes if outcome.seed is not None})
    lines += ["", "| drawn with seed | mutations that matter | caught at first | share |"]
    lines += ["|---|---|---|---|"]
    for seed in seeds:
        rows = [row for row in outcomes if row.seed == seed and not row.equivalent]
        at_first = sum(bool(row.failure) and not row.is_own_test for row in rows)
        lines.append(f"| {seed} | {len(rows)} | {at_first} | {at_first / len(rows):.0%} |")
    lines += ["", "| not caught | why |", "|---|---|"]
    for row in outcomes:
        if not row.failure:
            text = textwrap.shorten(row.mutation, LONGEST_TEXT, placeholder=" ...")
            text = text.replace("|", r"\|")
            lines.append(f"| `{text}` | {row.equivalent or 'a test is missing'} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
