"""Whoever mistypes the name of a method or of a distribution is told the nearest one."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest

from jaxtwin import JaxtwinError, Twin
from jaxtwin.sensitivity_analysis._analysis import checked_method
from jaxtwin.sensitivity_analysis._inputs import resolve_inputs
from jaxtwin.sensitivity_analysis._sampling import checked_kind


def unchecked(function: Any) -> Any:
    """Without the check of types that tests add, which refuses a wrong name before the function."""
    return inspect.unwrap(function)


@pytest.mark.parametrize(
    ("ask", "name"),
    [
        (lambda: unchecked(checked_method)("sobl"), "sobol"),
        (lambda: unchecked(checked_kind)("latin-hypercub"), "latin-hypercube"),
        (
            lambda: unchecked(resolve_inputs)("bound", None, Twin("single-cell"), None, 0.2),
            "bounds",
        ),
    ],
)
def test_a_mistyped_name_is_answered_with_the_nearest(ask: Callable[[], object], name: str):
    with pytest.raises(JaxtwinError, match=f"did you mean '{name}'"):
        ask()
