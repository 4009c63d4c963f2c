"""Small changes of the code: what may stand in the place of an expression, and a draw of them."""

import ast
import random
from collections.abc import Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import final

SOURCE = Path("src/jaxtwin")
TOP_LEVEL = "top level"
"""Stands for the package of the modules that are in none."""

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
    last_line: int
    before: str
    after: str
    start: int
    end: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}  {self.before}  ->  {self.after}"

    def applied(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]


def draw(copy: Path, count: int, dice: random.Random, tried: Set[str]) -> list[Mutation]:
    """Mutations spread over all packages and their files, without those that have been tried."""
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
            chosen = dice.choice(choices) if choices else None
            if chosen and str(chosen) not in tried and len(drawn) < count:
                drawn.append(chosen)
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
        return Mutation(
            inside, node.lineno, node.end_lineno, source[start:end].decode(), after, start, end
        )

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
            if text(first) != text(second):
                yield f"{text(node.func)}({text(second)}, {text(first)}{others})"


def is_text(node: ast.expr) -> bool:
    """Whether an operand is a piece of text, to which `-` does not apply."""
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def package_of(file: Path) -> str:
    """Of a file below `src/jaxtwin`."""
    return file.parts[0] if len(file.parts) > 1 else TOP_LEVEL
