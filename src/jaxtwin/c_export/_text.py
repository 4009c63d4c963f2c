"""Numbers, arrays and comments as C."""

import textwrap
from collections.abc import Iterable, Mapping

import numpy as np

from ..errors import ControlError

# The largest number of characters of the numbers in a line.
MAX_LINE = 92


def number(value: float, precision: str) -> str:
    """A constant that C reads back as the same number."""
    if precision == "double":
        return repr(float(value))
    return f"{np.float32(value).item()!r}f" if value else "0.0f"


def table(name: str, values: np.ndarray, comment: str, precision: str) -> str:
    """A constant array of one or two dimensions."""
    sizes = "".join(f"[{size}]" for size in values.shape)
    rows = values if values.ndim == 2 else values[None]
    lines = []
    for row in rows:
        text = ", ".join(number(value, precision) for value in row)
        wrapped = textwrap.wrap(text, MAX_LINE, break_long_words=False, break_on_hyphens=False)
        begin, end = ("    {", "},") if values.ndim == 2 else ("    ", "")
        lines += [begin + "\n     ".join(wrapped) + end]
    body = "\n".join(lines)
    return (
        f"/* {ascii_text(comment)} */\nstatic const {precision} {name}{sizes} = {{\n{body}\n}};\n"
    )


def tables_c(tables: Mapping[str, tuple[np.ndarray, str]], precision: str) -> tuple[str, int]:
    """Constant arrays as C, from name -> values and comment, and the number of their values.

    **Raises:** `ControlError` if a number is not finite in this precision.
    """
    for name, (values, _) in tables.items():
        with np.errstate(over="ignore"):
            cast = values.astype(np.float32 if precision == "float" else float)
        if not np.isfinite(cast).all():
            raise ControlError(
                f"export_c: {name}: expected finite numbers in {precision}, got "
                f"{values[~np.isfinite(cast)][0]:g}"
            )
    text = "".join(table(name, *of, precision) + "\n" for name, of in tables.items())
    return text, sum(values.size for values, _ in tables.values())


def comment_block(lines: Iterable[str]) -> str:
    """Lines as a comment, with the spaces at their beginning."""
    texts = (" " * (len(line) - len(line.lstrip(" "))) + ascii_text(line) for line in lines)
    return "/*\n" + "".join(f" * {text}".rstrip() + "\n" for text in texts) + " */\n"


def ascii_text(text: str) -> str:
    """Converts a text so that it is a valid comment for any compiler."""
    plain = " ".join(text.split()).encode("ascii", "replace").decode()
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
