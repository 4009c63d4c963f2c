"""A digest means the same in every process, and two things have the same only if they are alike."""

import functools
import os
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxtwin import Twin
from jaxtwin._compilation import _fingerprint
from jaxtwin._compilation._fingerprint import NoFingerprintError, fingerprint

SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.frozensets(SCALARS),
)


@dataclass(frozen=True)
class Pair:
    left: object
    right: object


@pytest.fixture(autouse=True)
def _this_file_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    known = (*_fingerprint.KNOWN_CODE, __name__.partition(".")[0])
    monkeypatch.setattr(_fingerprint, "KNOWN_CODE", known)


def twice(number: float) -> float:
    return 2 * number


@pytest.mark.slow
@given(VALUES, VALUES)
def test_only_values_that_print_alike_share_a_digest(first: Any, second: Any):
    def written(value: Any) -> str:
        return repr(sorted(value, key=repr)) if isinstance(value, frozenset) else repr(value)

    if fingerprint(first) == fingerprint(second):
        assert written(first) == written(second) or sets_in(first)


def sets_in(value: Any) -> bool:
    """Sets inside of other values print in any order."""
    return "frozenset" in repr(value)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (1, 1.0),
        (1, True),
        ((1, 2), [1, 2]),
        (("ab", "c"), ("a", "bc")),
        (((1,), 2), ((1, 2),)),
        (np.zeros(2), np.zeros(2, "float32")),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.array([1.0, 2.0]), np.array([2.0, 1.0])),
        (Pair(1, 2), Pair(2, 1)),
        (Pair(1, 2), (1, 2)),
        (functools.partial(twice, 1), functools.partial(twice, 2)),
        (len, abs),
        (int, float),
    ],
)
def test_what_would_compile_to_another_program_has_another_digest(first, second):
    assert fingerprint(first) != fingerprint(second)


def test_code_outside_of_the_package_has_no_fingerprint(monkeypatch):
    monkeypatch.undo()
    for own in (twice, Pair, Pair(1, 2)):
        with pytest.raises(NoFingerprintError):
            fingerprint(own)


@pytest.mark.parametrize("value", [lambda: 0, object(), [Pair(1, lambda: 0)], {1: object()}])
def test_values_that_mean_nothing_in_another_process_have_no_fingerprint(value):
    with pytest.raises(NoFingerprintError):
        fingerprint(value)


@pytest.mark.slow
def test_a_twin_has_the_same_digest_in_another_process():
    """Whatever the order in which that process goes through its sets (PYTHONHASHSEED)."""
    code = (
        "from jaxtwin import Twin; from jaxtwin._compilation._fingerprint import fingerprint; "
        "twin = Twin('dual-cell'); print(fingerprint((twin, twin.wiring, frozenset('abcdef'))))"
    )
    twin = Twin("dual-cell")
    here = fingerprint((twin, twin.wiring, frozenset("abcdef")))
    for seed in ("1", "2"):
        there = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        )
        assert there.stdout.strip() == here
