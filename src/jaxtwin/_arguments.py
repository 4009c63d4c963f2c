"""Checks of the arguments of public functions; each error is a single line.

Type checkers find most of these errors, but nobody runs them at a prompt.
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

from ._errors import JaxtwinError

Kind = TypeVar("Kind")
Failure = type[JaxtwinError]


def of_kind(where: str, value: object, kind: type[Kind], expected: str, error: Failure) -> Kind:
    """A value that is of a class.

    **Arguments:**

    - `where`: function and argument, for the message.
    - `expected`: what is expected, in words, for the message.

    **Raises:** `error` if it is of another.
    """
    if not isinstance(value, kind):
        _refuse(where, value, expected, error)
    return value


def whole_number(where: str, value: Any, least: int | None, error: Failure) -> int:
    """A whole number of Python or NumPy that is at least `least`; None for any.

    **Raises:** `error` if it is none; true and false are none.
    """
    above = {None: "", 1: " above 0"}.get(least, f" of at least {least}")
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        _refuse(where, value, f"a whole number{above}", error)
    return number


def finite_number(where: str, value: Any, error: Failure) -> float:
    """A finite number of Python, NumPy or JAX.

    **Raises:** `error` if it is none; true, false and text are none.
    """
    import numpy as np  # which the command line's help shall not wait for

    expected = "a finite number"
    if np.ndim(value) or np.asarray(value).dtype.kind not in "iuf":
        _refuse(where, value, expected, error)
    number = float(value)
    if not math.isfinite(number):
        _refuse(where, value, expected, error)
    return number


def true_or_false(where: str, value: Any, error: Failure) -> bool:
    """A truth value of Python or NumPy.

    **Raises:** `error` for anything else: a text such as "no" would count as true.
    """
    import numpy as np  # which the command line's help shall not wait for

    if not isinstance(value, bool | np.bool_):
        _refuse(where, value, "True or False", error)
    return bool(value)


def names_of(where: str, value: object, error: Failure) -> tuple[str, ...]:
    """Names, each once and in the order given; those of a set, which has no order that is the same
    in the next process, in that of the alphabet. A single text is one name.

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
    """Whether a value has parts in an order. A text is a single part, and a set has no order that
    is the same in the next process."""
    return isinstance(value, Iterable) and not isinstance(value, str | set | frozenset)


def mapping_of(where: str, value: Any, expected: str, error: Failure) -> Mapping[str, Any]:
    """A mapping whose keys are names.

    **Raises:** `error` for anything else.
    """
    # A table of pandas is no Mapping, but has what is needed of one.
    if not (isinstance(value, Mapping) or (hasattr(value, "keys") and hasattr(value, "items"))):
        _refuse(where, value, expected, error)
    for name in value:
        if not isinstance(name, str):
            _refuse(where, name, expected, error)
    return value


def path_of(where: str, value: object, error: Failure) -> Path:
    """A path of the file system, with `~` as the home folder.

    **Raises:** `error` for anything else, and for text that no path may hold.
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
    """Refuses what cannot be called and is not None.

    **Raises:** `error`.
    """
    if value is not None and not callable(value):
        _refuse(where, value, "a function or None", error)


def _refuse(where: str, value: object, expected: str, error: Failure) -> NoReturn:
    shown = " ".join(reprlib.repr(value).split())
    raise error(f"{where}: expected {expected}, got {shown}") from None
