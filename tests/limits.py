"""Limits that docstrings, error messages and docs/protocol.md state."""

from collections.abc import Callable
from typing import TypeAlias

import pytest

from jaxtwin import JaxtwinError

Limit: TypeAlias = tuple[Callable[..., object], dict[str, object], dict[str, object]]
"""A function, arguments at a limit, and arguments beyond it."""


def check_limit(
    make: Callable[..., object], allowed: dict[str, object], refused: dict[str, object]
) -> None:
    """The last value that is allowed is taken, and the next one is refused."""
    make(**allowed)
    with pytest.raises((JaxtwinError, ValueError), match=r"expected|no image|above|only"):
        make(**refused)
