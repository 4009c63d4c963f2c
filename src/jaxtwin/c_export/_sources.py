"""The C files of this package, with the name and the numbers of what is exported, as text.

The files beside this module, and those of `fmu/`, are C as it is compiled. Their names begin with
`model_` or `MODEL_`; the name of the exported files takes the place of `model`. Two parts are
generated: the sizes, which the header needs (`model_sizes.h`, inserted into it), and the numbers
(`model_numbers.h`, a file).
"""

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..control import LawTable
from ..errors import ControlError

# Numbers, arrays and comments as C.

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


FOLDER = Path(__file__).parent

_INCLUDE = re.compile(r'#include "(.*)"\n')

# What the files of a twin say only for numbers that parameters change; it is left out where these
# are constants.
_OF_PARAMETERS = re.compile(
    r"#ifdef MODEL_PARAMETERS\n.*?#endif\n\n?"
    r"|MODEL_(?:OF_INSTANCE|ITS_NUMBERS) | *MODEL_FIND_NUMBERS\(state\)\n",
    re.DOTALL,
)


class Code(NamedTuple):
    """The exported files, the number of constants, and the number of values in the state."""

    header: str
    source: str
    numbers: str
    coefficients: int
    states: int


class Parts(NamedTuple):
    """What is generated.

    - `about`: the comment at the beginning of the header.
    - `sizes`: the C that takes the place of `model_sizes.h`.
    - `constants`: the macros of the numbers, as C. `tables`: name -> values and comment.
    - `states`: the number of values in the state.
    - `law`: the C that takes the place of `law.c`; empty without.
    - `has_parameters`: whether parameters can be set, which change the numbers.
    """

    about: str
    sizes: str
    constants: str
    tables: Mapping[str, LawTable]
    states: int
    law: str = ""
    has_parameters: bool = False


def code_of(kind: str, name: str, precision: str, parts: Parts) -> Code:
    """Puts the files of a kind together, such as `controller.h` and `controller.c`.

    **Raises:** `ControlError` if a number is not finite in this precision.
    """
    upper = name.upper()
    tables = {
        f"{name}_{key}": (np.asarray(values, float), comment)
        for key, (values, comment) in parts.tables.items()
    }
    arrays, coefficients = tables_c(tables, precision)
    header = included(FOLDER / f"{kind}.h", {})
    source = included(FOLDER / f"{kind}.c", {"law.c": parts.law})
    if not parts.has_parameters:
        header, source = (_OF_PARAMETERS.sub("", text) for text in (header, source))
    header = renamed(header, name).replace(f'#include "{name}_sizes.h"\n', parts.sizes)
    return Code(
        parts.about + header,
        renamed(source, name),
        f"/* The numbers of {name}.c, written by jaxtwin. */\n#ifndef {upper}_NUMBERS_H\n"
        f"#define {upper}_NUMBERS_H\n\n{parts.constants}\n{arrays}#endif\n",
        coefficients,
        parts.states,
    )


def renamed(text: str, name: str) -> str:
    """Puts a name in the place of `model`."""
    text = re.sub(r"\bmodel(?=_|\.h)", name, text)
    return re.sub(r"\bMODEL(?=_)", name.upper(), text)


def type_of_numbers(name: str, precision: str) -> str:
    """The C that says which type all numbers have."""
    is_float = int(precision == "float")
    return f"#define {name.upper()}_IS_FLOAT {is_float}\ntypedef {precision} {name}_real;\n"


def defines(
    name: str,
    constants: Mapping[str, int | float],
    precision: str,
    comments: Mapping[str, str] | None = None,
) -> str:
    """Macros as C: whole numbers as they are, others in the given precision.

    **Raises:** `ControlError` if a number is not finite in this precision.
    """
    lines = []
    for key, value in constants.items():
        text = str(value)
        if not isinstance(value, int):
            with np.errstate(over="ignore"):
                cast = np.float32(value) if precision == "float" else value
            if not np.isfinite(cast):
                raise ControlError(
                    f"export_c: {name}_{key}: expected a finite number in {precision}, got {value}"
                )
            text = number(value, precision)
        comment = f" /* {comments[key]} */" if comments and key in comments else ""
        lines.append(f"#define {name.upper()}_{key} {text}{comment}\n")
    return "".join(lines)


def whole_numbers(name: str, key: str, values: Sequence[int], comment: str = "") -> str:
    """An array of whole numbers as C."""
    text = ", ".join(map(str, values))
    if len(text) > MAX_LINE:
        text = "\n    " + "\n    ".join(textwrap.wrap(text, MAX_LINE)) + "\n"
    above = f"/* {comment} */\n" if comment else ""
    return f"{above}static const int {name}_{key}[{len(values)}] = {{{text}}};\n"


def included(file: Path, given: Mapping[str, str]) -> str:
    """The text of a file with the parts that it includes, given ones and those at a path from it.

    A part is included where it is asked for, so that each exported model is a single source.
    """

    def part(match: re.Match[str]) -> str:
        beside = file.parent / match[1]
        if match[1] in given:
            return given[match[1]]
        return included(beside, given) if beside.exists() else match[0]

    return _INCLUDE.sub(part, file.read_text(encoding="ascii"))
