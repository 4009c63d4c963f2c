"""Which tests are likely to notice a changed expression."""

import ast
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import TypeAlias, final

from ._mutants import SOURCE, Mutation

Definition: TypeAlias = "ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign"

MOST_STEPS = 4
"""Steps from the changed definition to a test: a test that names it is one step away."""

MOST_OTHERS = 30
"""Of the tests of other packages, so many at most run for one mutation."""

TYPICAL_WORDS = 20
"""The words of a short test. A long one has words in common with anything, so what it has in common
counts less."""


@final
class NearestTests:
    """Finds tests by the names that they and the definitions of the package mention, and by words.

    A name stands for whatever has it, in any module, so a test may be listed that does not reach
    the changed expression. Tests of a rig file reach it through a text, without any name: they have
    the words of its fields and messages in common with it.
    """

    def __init__(self, copy: Path) -> None:
        self.copy = copy
        self.users: dict[str, set[str]] = defaultdict(set)
        """Name -> the definitions that mention it."""
        for file in sorted((copy / SOURCE).rglob("*.py")):
            for name, node in definitions(ast.parse(file.read_bytes())):
                for used in mentioned(node) - {name}:
                    self.users[used].add(name)
        self.tests: dict[str, set[str]] = defaultdict(set)
        """Name -> the tests that mention it, in their own text or in what their file defines."""
        self.words: dict[str, set[str]] = {}
        """Test -> the words of the same texts."""
        for file in sorted(copy.glob("tests/**/test_*.py")):
            tree = ast.parse(file.read_bytes())
            there = dict(definitions(tree))
            inside = str(file.relative_to(copy))
            for name, node in there.items():
                if name.startswith("test_"):
                    test, used = f"{inside}::{name}", _with_those_of(node, there)
                    parts = [node, *(there[other] for other in sorted(used) if other in there)]
                    self.words[test] = set[str]().union(*map(words, parts))
                    for other in used:
                        self.tests[other].add(test)
        self.tests_with = Counter(word for those in self.words.values() for word in those)
        """Word -> the number of tests that have it."""

    def of(self, mutation: Mutation, own: list[str]) -> list[str]:
        """Tests of the package from the nearest to the farthest, and some of all others: those with
        the most and the rarest words in common with the definition that is changed. File by file,
        in turn one of the package's and one of the others.

        **Arguments:**

        - `own`: the files of tests that belong to the package of the mutation.
        """
        around = self._around(mutation)
        steps = self._steps({name for name, _ in around})
        topic = set(mutation.file.stem.strip("_").split("_"))

        def distance_of(test: str) -> tuple[int, bool, str]:
            return steps[test], topic.isdisjoint(Path(file_of(test)).stem.split("_")), test

        text = topic.union(*(words(node) for _, node in around))

        def likeness_of(test: str) -> float:
            rare = (math.log(len(self.words) / self.tests_with[w]) for w in text & self.words[test])
            return sum(rare) / math.sqrt(TYPICAL_WORDS + len(self.words[test]))

        mine = sorted((test for test in steps if file_of(test) in own), key=distance_of)
        others = (test for test in self.words if file_of(test) not in own)
        like = sorted(others, key=likeness_of, reverse=True)[:MOST_OTHERS]
        in_turn = zip_longest(by_file(mine), by_file(like), fillvalue=[])
        return [test for pair in in_turn for tests in pair for test in tests]

    def _steps(self, around: set[str]) -> dict[str, int]:
        """Test -> the steps from some names to it, for tests that are reached within the most."""
        steps: dict[str, int] = {}
        names = seen = around
        for step in range(MOST_STEPS):
            for test in (test for name in names for test in self.tests[name]):
                steps.setdefault(test, step)
            names = {user for name in names for user in self.users[name]} - seen
            seen = seen | names
        return steps

    def _around(self, mutation: Mutation) -> list[tuple[str, Definition]]:
        """The innermost definition around a mutation: of a method, and its class if it is a method
        that Python calls itself. All of the file if there is none."""
        tree = ast.parse((self.copy / mutation.file).read_bytes())
        every = list(definitions(tree))
        around = [
            (name, node)
            for name, node in every
            if node.lineno <= mutation.line <= (node.end_lineno or 0)
        ]
        if not around:
            return every
        innermost = max(around, key=lambda one: one[1].lineno)
        if innermost[0].startswith("__") or isinstance(around[-1][1], ast.AnnAssign):
            return [one for one in around if one[0] != innermost[0]]
        return [innermost]


def file_of(test: str) -> str:
    """Of `FILE::NAME`."""
    return test.partition("::")[0]


def by_file(tests: list[str]) -> list[list[str]]:
    """The tests of each file, in the order of the first of each."""
    files: dict[str, list[str]] = {}
    for test in tests:
        files.setdefault(file_of(test), []).append(test)
    return list(files.values())


def words(node: ast.AST) -> set[str]:
    """The words of a piece of code in lower case: of its names, their parts, and its texts."""
    found = set[str]()
    for part in ast.walk(node):
        match part:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                found.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.keyword(arg=str(name)):
                found.add(name)
            case ast.Constant(value=str(text)):
                found.update(re.findall(r"[^\W\d_]\w+", text))
    parts = {part for name in found for part in name.split("_") if len(part) > 2}
    return {word.lower() for word in found | parts}


def definitions(tree: ast.AST) -> Iterator[tuple[str, Definition]]:
    """Functions, classes, their methods and fields, and what a module assigns."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node
            if isinstance(node, ast.ClassDef):
                yield from definitions(node)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                for part in ast.walk(target):
                    if isinstance(part, ast.Name):
                        yield part.id, node


def mentioned(node: ast.AST) -> set[str]:
    """The names and attributes in a piece of code, and the names in its texts."""
    names = set[str]()
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            names.add(part.id)
        elif isinstance(part, ast.Attribute):
            names.add(part.attr)
        elif isinstance(part, ast.Constant) and isinstance(part.value, str):
            names |= {word for word in [part.value] if word.isidentifier()}
    return names


def _with_those_of(node: Definition, there: dict[str, Definition]) -> set[str]:
    """The names that a test mentions, or a fixture or function of its file that it uses."""
    names, left = set[str](), [node]
    while left:
        current = left.pop()
        arguments = current.args.args if isinstance(current, ast.FunctionDef) else []
        more = mentioned(current) | {argument.arg for argument in arguments}
        left += [there[name] for name in more - names if name in there]
        names |= more
    return names
