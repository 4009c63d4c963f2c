"""Checks of the arguments of public functions; each error is a single line.

Type checkers find most of these errors, but nobody runs a type checker at a prompt.
"""

import errno
import math
import operator
import os
import reprlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from ._pint_quantities import is_pint
from .errors import JaxtwinError

Kind = TypeVar("Kind")
Failure = type[JaxtwinError]


def of_kind(
    where: str,
    value: object,
    kind: type[Kind] | tuple[type[Kind], ...],
    expected: str,
    error: Failure,
) -> Kind:
    """Checks that a value is of a class, or of one of several, and returns it.

    **Arguments:**

    - `where`: the function and the argument, for the message.
    - `expected`: the expected value in words, for the message.

    **Raises:** `error` if it is of another class.
    """
    if not isinstance(value, kind):
        _refuse(where, value, expected, error)
    return value


def whole_number(where: str, value: Any, least: int | None, error: Failure) -> int:
    """Checks a whole number of Python or NumPy, and returns it.

    **Arguments:**

    - `least`: the smallest allowed number; None if any number is allowed.

    **Raises:** `error` for anything else, also for true and false.
    """
    above = {None: "", 1: " above 0"}.get(least, f" of at least {least}")
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        _refuse(where, value, f"a whole number{above}", error)
    return number


def finite_number(
    where: str,
    value: Any,
    error: Failure,
    *,
    above: float | int | None = None,
    least: float | int | None = None,
    below: float | int | None = None,
    most: float | int | None = None,
    unit: str = "",
) -> float:
    """Checks a finite number of Python, NumPy or JAX, and returns it.

    **Arguments:**

    - `above`, `least`: the number must be above this one, or at least this one; None for any.
    - `below`, `most`: it must be below this one, or at most this one; None for any.
    - `unit`: its unit, for the message.

    **Raises:** `error` for anything else, also for true, false and text.
    """
    import numpy as np  # imported here, so that the command line's help is quick

    number = math.nan
    # Neither what JAX traces nor rows of different lengths are an array.
    with suppress(TypeError, ValueError):
        # A conversion would lose the unit of a quantity of pint.
        if not is_pint(value) and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iuf":
            number = float(value)
    is_above = (above is None or number > above) and (least is None or number >= least)
    is_below = (below is None or number < below) and (most is None or number <= most)
    if not (math.isfinite(number) and is_above and is_below):
        expected = _range_text(above, least, below, most) + (f", in {unit}" if unit else "")
        _refuse(where, value, expected + (" without a unit" if is_pint(value) else ""), error)
    return number


def _range_text(
    above: float | int | None,
    least: float | int | None,
    below: float | int | None,
    most: float | int | None,
) -> str:
    """A number within bounds, as a message names it."""
    if least is not None and most is not None:
        return f"a number from {least:g} to {most:g}"
    if above is not None and below is not None:
        return f"a number between {above:g} and {below:g}"
    ends = {"above": above, "of at least": least, "below": below, "of at most": most}
    bounds = " and ".join(f"{word} {end:g}" for word, end in ends.items() if end is not None)
    return f"a number {bounds}" if bounds else "a finite number"


def true_or_false(where: str, value: Any, error: Failure) -> bool:
    """Checks a truth value of Python or NumPy, and returns it.

    **Raises:** `error` for anything else: a text such as "no" would count as true.
    """
    import numpy as np  # imported here, so that the command line's help is quick

    if not isinstance(value, bool | np.bool_):
        _refuse(where, value, "True or False", error)
    return bool(value)


def names_of(where: str, value: object, error: Failure) -> tuple[str, ...]:
    """Returns names in the given order, without repetitions. The names of a set are sorted, because
    its order differs between processes. A single text is one name.

    **Raises:** `error` for anything else.
    """
    expected = "one name or several"
    if isinstance(value, str):
        return (value,)
    if not isinstance(value, Iterable):
        _refuse(where, value, expected, error)
    names = tuple(value)
    for name in names:
        if not isinstance(name, str):
            _refuse(where, name, expected, error)
    return tuple(sorted(names) if isinstance(value, set | frozenset) else dict.fromkeys(names))


def is_ordered(value: object) -> bool:
    """Whether a value consists of parts in an order. A text is a single part, and the order of a
    set differs between processes."""
    return isinstance(value, Iterable) and not isinstance(value, str | set | frozenset)


def mapping_of(where: str, value: Any, expected: str, error: Failure) -> Mapping[str, Any]:
    """Checks a mapping whose keys are names, and returns it.

    **Raises:** `error` for anything else.
    """
    # A table of pandas is not a Mapping, but has the methods that are needed here.
    if not (isinstance(value, Mapping) or (hasattr(value, "keys") and hasattr(value, "items"))):
        _refuse(where, value, expected, error)
    for name in value:
        if not isinstance(name, str):
            _refuse(where, name, expected, error)
    return value


def path_of(where: str, value: object, error: Failure) -> Path:
    """Returns a path of the file system, with `~` replaced by the home folder.

    **Raises:** `error` for anything else, and for text that is not allowed in a path.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        _refuse(where, value, "the path of a file or a folder", error)
    path = Path(text)
    with suppress(RuntimeError):  # a user of that name is not known
        path = path.expanduser()
    try:
        path.lstat()
    except OSError as problem:
        # A missing or unreadable file is reported where it is opened.
        if problem.errno == errno.ENAMETOOLONG:
            _refuse(where, value, "a path whose names are not too long", error)
    return path


def check_callable(where: str, value: object, error: Failure) -> None:
    """Checks that a value can be called or is None.

    **Raises:** `error` for anything else.
    """
    if value is not None and not callable(value):
        _refuse(where, value, "a function or None", error)


def _refuse(where: str, value: object, expected: str, error: Failure) -> NoReturn:
    shown = " ".join(reprlib.repr(value).split())
    raise error(f"{where}: expected {expected}, got {shown}") from None
