"""Numbers, arrays and comments as C."""

import textwrap
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np


class Code(NamedTuple):
    """Header and source of a model; how many constants and how many states it has."""

    header: str
    source: str
    coefficients: int
    states: int


def number(value: float, precision: str) -> str:
    """A constant that C reads back as the same number."""
    if precision == "double":
        return repr(float(value))
    return f"{np.float32(value).item()!r}f" if value else "0.0f"


def table(name: str, values: np.ndarray, precision: str, comment: str) -> str:
    """A constant array of one or two dimensions."""
    sizes = "".join(f"[{size}]" for size in values.shape)
    rows = values if values.ndim == 2 else values[None]
    lines = []
    for row in rows:
        text = ", ".join(number(value, precision) for value in row)
        wrapped = textwrap.wrap(text, 92, break_long_words=False, break_on_hyphens=False)
        begin, end = ("    {", "},") if values.ndim == 2 else ("    ", "")
        lines += [begin + "\n     ".join(wrapped) + end]
    body = "\n".join(lines)
    return (
        f"/* {ascii_text(comment)} */\nstatic const {precision} {name}{sizes} = {{\n{body}\n}};\n"
    )


def comment_block(lines: Iterable[str]) -> str:
    """Lines as a comment."""
    return "/*\n" + "".join(f" * {ascii_text(line)}".rstrip() + "\n" for line in lines) + " */\n"


def ascii_text(text: str) -> str:
    """Text that may stand in a comment of any compiler."""
    plain = " ".join(text.split()).encode("ascii", "replace").decode()
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
