"""Tests run with checks of all annotated types and shapes: here is what they find."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from checked_types import check_package

from jaxtwin._statistics import fit_percent, fit_text

PACKAGE = """
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from elsewhere import Unknown


@dataclass(frozen=True)
class Line:
    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]

    def longer(self, x: Float[np.ndarray, " more"], y: Float[np.ndarray, " more"]) -> "Line":
        return Line(np.append(self.x, x), np.append(self.y, y))


def product(a: Float[np.ndarray, "n m"], b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n k"]:
    return a @ b


def wrong_product(a: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
    return a.T


def half(number: int, *, of: "Unknown | None" = None) -> "int":
    return number / 2


def outer(number: int) -> int:
    def inner(text: str) -> int:
        return len(text)

    return inner(number)


def counted(number: int) -> Iterator[int]:
    yield from range(number)
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    (tmp_path / "checked_example.py").write_text(PACKAGE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "checked_example", raising=False)
    check_package("checked_example")
    return importlib.import_module("checked_example")


def test_axes_with_one_name_are_of_one_length(package: ModuleType) -> None:
    two, three = np.zeros(2), np.zeros(3)
    package.Line(two, two).longer(three, three)
    with pytest.raises(TypeError, match="y"):
        package.Line(two, three)
    with pytest.raises(TypeError, match="y"):
        package.Line(two, two).longer(two, three)
    package.product(np.zeros((2, 3)), np.zeros((3, 4)))
    with pytest.raises(TypeError, match="b"):
        package.product(np.zeros((2, 3)), np.zeros((2, 4)))
    with pytest.raises(TypeError, match="return"):
        package.wrong_product(np.zeros((2, 3)))


def test_types_of_arguments_and_results_are_those_annotated(package: ModuleType) -> None:
    with pytest.raises(TypeError, match="return"):
        package.half(3)
    with pytest.raises(TypeError, match="number"):
        package.half("3")
    with pytest.raises(TypeError, match="text"):
        package.outer(3)
    assert list(package.counted(2)) == [0, 1]
    with pytest.raises(TypeError, match="number"):
        package.counted("2")


def test_functions_of_this_package_are_checked() -> None:
    with pytest.raises(TypeError, match="simulated"):
        fit_percent(np.zeros((3, 1)), np.zeros((4, 1)))
    with pytest.raises(TypeError, match="unit"):
        fit_text(50.0, 3)  # pyright: ignore[reportArgumentType]
