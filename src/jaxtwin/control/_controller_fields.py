"""Reads and writes values of a controller file: numbers with units, lists, matrices."""

import json
from collections.abc import Callable
from typing import Any, NoReturn, TypeAlias

import numpy as np
from jaxtyping import Float

from ..rig._units import Kind, parse_quantity, range_problem, unit_scale

Refuse: TypeAlias = Callable[[str, str], NoReturn]
"""A function of a field and a message that raises `ControlError`."""


def quantity(found: object, name: str, kind: Kind, no: Refuse, *, is_list: bool = True) -> Any:
    """Reads a number with its unit, or a list of such numbers, in SI units.

    **Arguments:**

    - `found`: the value in the file.
    - `name`: the name of the field, for messages.
    - `kind`: the quantity that is allowed.
    - `no`: raises the error.
    - `is_list`: whether a list, with an entry for each cell or output, is allowed.
    """
    if is_list and isinstance(found, list) and found:
        parts = enumerate(found)
        return np.array([quantity(p, f"{name}[{n}]", kind, no, is_list=False) for n, p in parts])
    if not isinstance(found, str):
        no(name, f"expected {kind}, got {found!r}")
    try:
        number = parse_quantity(found, kind)
    except ValueError as problem:
        no(name, f"expected {kind}, got {found!r}, {problem}")
    problem = range_problem(number, kind)
    if problem:
        no(name, f"expected {problem}, got {found!r}")
    return number


def numbers(found: Any, name: str, no: Refuse) -> list[float]:
    """Reads a list of numbers without units."""
    is_list = isinstance(found, list)
    if not is_list or any(isinstance(n, bool) or not isinstance(n, int | float) for n in found):
        no(name, f"expected a list of numbers, got {found!r}")
    try:
        return [float(number) for number in found]
    except OverflowError:
        no(name, f"expected a list of numbers, got {found!r}")


def matrix(
    found: object, name: str, kind: Kind, shape: tuple[int | None, int | None], no: Refuse
) -> Float[np.ndarray, "rows columns"]:
    """Reads a matrix: a list of rows, or a table of `unit` and `rows` if the numbers have a unit.

    **Arguments:**

    - `kind`: the quantity of the numbers; a matrix of the unit "" is a list of rows.
    - `shape`: the required numbers of rows and columns; None for any number.
    """
    scale, rows = 1.0, found
    if kind.unit:
        example = f'{{ unit = "{kind.unit}", rows = [[1.0, 2.0]] }}'
        if not isinstance(found, dict) or set(found) != {"unit", "rows"}:
            no(name, f"expected unit and rows, such as {example}, got {found!r}")
        try:
            scale, _ = unit_scale(str(found["unit"]), kind)
        except ValueError as problem:
            no(f"{name}.unit", f"expected {kind.unit} or alike, got {found['unit']!r}, {problem}")
        rows = found["rows"]
    rows = rows if isinstance(rows, list) else [rows]
    lists = [numbers(row, name, no) for row in rows]
    lengths = sorted({len(row) for row in lists})
    array = scale * np.array(lists) if len(lengths) == 1 else np.zeros((0, 0))
    fits = all(size in (None, has) for size, has in zip(shape, array.shape, strict=True))
    if not (fits and array.size and np.isfinite(array).all()):
        expected = " x ".join("any" if size is None else str(size) for size in shape)
        no(name, f"expected {expected} finite numbers, got {len(lists)} rows of {lengths} numbers")
    return array


def groups(found: object, no: Refuse) -> list[Any]:
    """Reads the outputs of a controller: a list of channels, or of lists of channels."""

    def is_names(part: object) -> bool:
        return isinstance(part, list) and bool(part) and all(isinstance(n, str) for n in part)

    if not (
        isinstance(found, list) and found and all(isinstance(p, str) or is_names(p) for p in found)
    ):
        no("measured", f"expected channels, or lists of channels, got {found!r}")
    return found


def as_quantity(value: Any, kind: Kind) -> str:
    """Returns the text of a number, or of a list of numbers, with its SI unit."""
    texts = [f"{number!r} {kind.unit}".strip() for number in np.ravel(value).tolist()]
    return json.dumps(texts[0] if np.ndim(value) == 0 else texts)


def as_matrix(value: object, kind: Kind) -> str:
    """Returns the text of a matrix with one row on each line."""
    rows = ",\n    ".join(json.dumps(row) for row in np.asarray(value, float).tolist())
    text = f"[\n    {rows},\n]"
    return f'{{ unit = "{kind.unit}", rows = {text} }}' if kind.unit else text
