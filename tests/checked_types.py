"""Checks of every annotated type and shape of the package, as jaxtyping's, in less time.

`jaxtyping.jaxtyped` binds the arguments of each call by name, checks them twice, and opens a scope
for the names of axes: in a test of a live loop a third of the time. Here beartype checks arguments
and results once, and only a function that names axes has a scope.
"""

import functools
import inspect
import typing
from collections.abc import Callable
from dataclasses import is_dataclass
from types import FunctionType, SimpleNamespace
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, jaxtyped

# A wrong type is a `TypeError`, as it is to jaxtyping.
CHECKS = BeartypeConf(violation_type=TypeError)


def check_package(name: str) -> None:
    """Checks a package that is imported later."""
    jaxtyping.install_import_hook(name, "beartype.beartype")
    # What the hook puts before each class and function.
    jaxtyping.jaxtyped = _decorator


def _decorator(*, typechecker: Any) -> Callable[[Any], Any]:
    return functools.partial(_checked, typechecker=typechecker)


def _checked(thing: Any, typechecker: Any) -> Any:
    """A class or function with checks."""
    if inspect.isclass(thing):
        # The hook has been at an `__init__` that is not that of a dataclass.
        if is_dataclass(thing) and not hasattr(thing.__init__, "__wrapped__"):
            thing.__init__ = _checked(thing.__init__, typechecker)
        return thing
    if not isinstance(thing, FunctionType) or inspect.isgeneratorfunction(thing):
        return jaxtyped(thing, typechecker=typechecker)
    hints = _hints(thing)
    checked = beartype(conf=CHECKS)(_copy(thing, hints))
    if not any(map(_names_axes, hints.values())):
        return functools.update_wrapper(checked, thing)

    @functools.wraps(thing)
    def in_a_scope(*args: Any, **kwargs: Any) -> Any:
        with jaxtyped("context"):
            return checked(*args, **kwargs)

    return in_a_scope


def _hints(function: FunctionType) -> dict[str, Any]:
    """The annotations without quotes, `Any` in place of one that names what is not there."""
    try:
        return typing.get_type_hints(function, include_extras=True)
    except Exception:
        hints: dict[str, Any] = {}
        for name, annotation in function.__annotations__.items():
            alone = SimpleNamespace(__annotations__={name: annotation})
            try:
                hints |= typing.get_type_hints(alone, function.__globals__, include_extras=True)
            except Exception:
                hints[name] = Any
        return hints


def _copy(function: FunctionType, hints: dict[str, Any]) -> FunctionType:
    """The function with other annotations; it keeps its own."""
    copy = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    copy.__module__ = function.__module__
    copy.__qualname__ = function.__qualname__
    copy.__annotations__ = hints
    return copy


def _names_axes(hint: Any) -> bool:
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return True
    if getattr(hint, "__module__", "").startswith("jaxtyping"):
        return True
    if isinstance(hint, typing.TypeVar):
        return any(map(_names_axes, (hint.__bound__, *hint.__constraints__)))
    parts = hint if isinstance(hint, list) else typing.get_args(hint)
    return any(map(_names_axes, parts))
